//! `completions` and `manual`: shell completions and manual pages, generated from the definition of the command
//! line.

use clap::{Args, Command};

use crate::session::Error;
use crate::terminal;

/// Prints completions for a shell.
#[derive(Debug, Args)]
pub struct Completions {
    /// Shell to print the completions for
    shell: clap_complete::Shell,
}

impl Completions {
    /// Prints the completion script of the shell.
    pub fn run(self, mut command: Command) -> Result<u8, Error> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut command, "lightharmony", &mut script);
        terminal::print(&String::from_utf8_lossy(&script))?;
        Ok(0)
    }
}

/// Prints the manual page, or writes one page per command.
#[derive(Debug, Args)]
pub struct Manual {
    /// Folder to write one page per command to, such as /usr/local/share/man/man1
    #[arg(long, value_name = "DIR")]
    to: Option<std::path::PathBuf>,
}

impl Manual {
    /// Prints or writes the pages.
    pub fn run(self, command: Command) -> Result<u8, Error> {
        match self.to {
            Some(folder) => {
                let written = std::fs::create_dir_all(&folder);
                written.and_then(|()| clap_mangen::generate_to(command, &folder)).map_err(|source| {
                    Error::Cache(format!("cannot write to `{}`: {source}", folder.display()))
                })?;
            }
            None => {
                let mut page = Vec::new();
                clap_mangen::Man::new(command).render(&mut page)?;
                terminal::print(&String::from_utf8_lossy(&page))?;
            }
        }
        Ok(0)
    }
}
