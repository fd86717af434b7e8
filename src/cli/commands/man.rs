//! `hdralign man`.

use crate::cli::process::leftovers;
use clap_mangen::Man;
use hdralign::error::Error;
use hdralign::write::{self, Target};
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const AFTER_HELP: &str = "\
Examples:
  hdralign man | man -l -                       the page of the program
  hdralign man ~/.local/share/man/man1          one page for each command: hdralign.1, ...";

#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct Args {
    /// Write the pages of all commands into this folder; it is created if it does not exist. Without it, the page of the
    /// program is printed to stdout
    #[arg(value_name = "FOLDER")]
    folder: Option<PathBuf>,

    /// Replace existing pages
    #[arg(short, long)]
    force: bool,
}

pub fn run(args: &Args) -> Result<ExitCode, Error> {
    let mut program = crate::cli::program().disable_help_subcommand(true);
    program.build();
    let Some(folder) = &args.folder else {
        let page = page(&program).map_err(|source| Error::Write { path: "standard output".into(), source })?;
        crate::cli::tell(&String::from_utf8_lossy(&page))?;
        return Ok(ExitCode::SUCCESS);
    };
    leftovers::clear(&[folder.join("hdralign.1")]);
    let paths = pages(&program, folder, args.force)?;
    let names: String = paths.iter().map(|path| format!("{}\n", path.display())).collect();
    crate::cli::tell(&names)?;
    Ok(ExitCode::SUCCESS)
}

/// Writes the manual pages of `program` and all its commands into `folder`, and returns their paths.
fn pages(program: &clap::Command, folder: &Path, overwrite: bool) -> Result<Vec<PathBuf>, Error> {
    let failed = |source| Error::Write { path: folder.to_owned(), source };
    std::fs::create_dir_all(folder).map_err(failed)?;
    let commands = std::iter::once(program).chain(program.get_subcommands());
    let commands: Vec<_> = commands.map(|c| (folder.join(Man::new(c.clone()).get_filename()), c)).collect();
    let paths: Vec<PathBuf> = commands.iter().map(|(path, _)| path.clone()).collect();
    write::check_targets(&Target::of("FOLDER", &paths), &[], overwrite)?;
    let write = |(path, command): &(PathBuf, &clap::Command)| write::complete(path, &page(command).map_err(failed)?);
    write::rename_all(commands.iter().map(write).collect::<Result<_, _>>()?, overwrite)?;
    Ok(paths)
}

/// Returns the manual page of one command.
fn page(command: &clap::Command) -> io::Result<Vec<u8>> {
    let mut page = Vec::new();
    let source = concat!("hdralign ", env!("CARGO_PKG_VERSION"));
    Man::new(command.clone()).source(source).manual("hdralign").render(&mut page)?;
    Ok(page)
}
