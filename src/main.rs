//! `hdralign`, the program: arguments in, exit code out.

mod cli;

/// Pictures come and go by the stage: this one gives their memory back, where the system's keeps it between the smaller things.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    cli::run()
}
