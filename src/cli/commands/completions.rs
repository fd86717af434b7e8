//! `hdralign completions`.

use clap::ValueEnum;
use clap_complete::Shell;
use hdralign::error::Error;
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Examples:
  hdralign completions bash > ~/.local/share/bash-completion/completions/hdralign
  hdralign completions zsh > ~/.zfunc/_hdralign
  hdralign completions fish > ~/.config/fish/completions/hdralign.fish
  hdralign completions powershell >> $PROFILE
For zsh, also write `fpath+=~/.zfunc` into ~/.zshrc, before the line with `compinit`.";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    /// The shell that completes
    #[arg(value_enum, value_name = "SHELL")]
    shell: ShellArg,
}

/// The shells, in words that are typed.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum ShellArg {
    /// GNU Bash, with bash-completion
    Bash,
    /// The Z shell
    Zsh,
    /// fish
    Fish,
    /// PowerShell
    Powershell,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let shell = match args.shell {
        ShellArg::Bash => Shell::Bash,
        ShellArg::Zsh => Shell::Zsh,
        ShellArg::Fish => Shell::Fish,
        ShellArg::Powershell => Shell::PowerShell,
    };
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut crate::cli::program(), "hdralign", &mut script);
    crate::cli::tell(&String::from_utf8_lossy(&script))?;
    Ok(ExitCode::SUCCESS)
}
