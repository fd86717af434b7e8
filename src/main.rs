//! The program `hdralign`: parses the arguments, runs a command and returns the exit code.

mod cli;

/// This allocator returns the freed memory of frames to the system after each stage. Many system allocators keep such
/// memory because of fragmentation.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    cli::run()
}
