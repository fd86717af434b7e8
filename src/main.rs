//! The program `hdralign`: parses the arguments, runs a command and returns the exit code.

mod cli;

/// Returns the memory of frames to the system after each stage; many system allocators keep it, due to fragmentation.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    cli::run()
}
