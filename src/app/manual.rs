//! Completions for shells and pages for `man`, from the same definition as the command line itself.

use anyhow::Context as _;
use clap::Command;
use clap_complete::Shell;
use std::fs;
use std::io::Write;
use std::path::Path;

/// Writes the completions of a shell.
///
/// # Errors
/// When they cannot be written.
pub fn completions(command: &mut Command, shell: Shell, out: &mut impl Write) -> anyhow::Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(shell, command, "volition", &mut text);
    out.write_all(&text)?;
    Ok(())
}

/// Writes a page for the command and one for each of what it does into a folder, which is made if it does not exist.
///
/// # Errors
/// When they cannot be written.
pub fn pages(command: Command, folder: &Path) -> anyhow::Result<usize> {
    fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let mut written = 0;
    for (name, of) in std::iter::once(("volition".to_owned(), &command))
        .chain(command.get_subcommands().map(|of| (format!("volition-{}", of.get_name()), of)))
    {
        let mut page = Vec::new();
        // `volition run` is one command, and `volition-run` the name of its page.
        let of = of.clone().display_name(name.clone()).version(env!("CARGO_PKG_VERSION"));
        clap_mangen::Man::new(of).render(&mut page)?;
        let path = folder.join(format!("{name}.1"));
        fs::write(&path, page).with_context(|| format!("cannot write {}", path.display()))?;
        written += 1;
    }
    Ok(written)
}
