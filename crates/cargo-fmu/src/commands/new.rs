//! `cargo fmu new`: writes a package with a controller, and with a plant and their closed loop.

use std::ffi::OsStr;
use std::fs;
use std::io::Write;
use std::path::{self, Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use fmu_build::dependency::{Dependency, quoted};

use crate::filled;
use crate::template::{FILES, Part, select};

/// Where to write the package.
#[derive(Debug, Args)]
pub struct NewArgs {
    /// Folder of the package, which must not exist
    path: PathBuf,
    /// Name of the package [default: the name of the folder]
    #[arg(long)]
    name: Option<String>,
    /// Write the controller only, without a plant and a closed loop
    #[arg(long)]
    no_plant: bool,
    /// Write the controller in C, with a model in Rust around it
    #[arg(long)]
    c: bool,
    /// Version of fmu-export, folder with its sources, or URL of its git repository [default: the
    /// version of this program, or the checkout that it was built in]
    #[arg(long, value_name = "VERSION|PATH|URL")]
    fmu_export: Option<Dependency>,
}

/// Names that the template uses for something else.
const TAKEN: [&str; 7] =
    ["Driver", "FmuExport", "Model", "ModelError", "Result", "Simulate", "Start"];

/// Writes the package and prints what to do next.
///
/// # Errors
/// The folder exists, its name is not a valid name of a package, or it cannot be written.
pub fn run(args: &NewArgs, out: &mut impl Write) -> Result<()> {
    let shown = args.path.display();
    let folder = path::absolute(&args.path).with_context(|| format!("cannot create {shown}"))?;
    let of_folder = || folder.file_name().and_then(OsStr::to_str);
    let name = args.name.as_deref().or_else(of_folder);
    let name = name.with_context(|| format!("{shown} does not name a folder"))?;
    let model = model_name(name)?;
    ensure!(
        fs::symlink_metadata(&folder).is_err(),
        "{shown} exists; expected the name of a new folder"
    );
    let dependency = args.fmu_export.clone().unwrap_or_default();
    let plant = (!args.no_plant).then_some(Part::Plant);
    let parts = plant.into_iter().chain(args.c.then_some(Part::C)).collect();
    let mut package = Package { name, model: &model, dependency, parts };
    package.create(&folder).map_err(|error| {
        let _ = fs::remove_dir_all(&folder);
        error.context(format!("cannot create the package {name}"))
    })?;
    let has_workflow = package.parts.contains(&Part::Workflow);
    let (models, simulate) = match args.no_plant {
        false => {
            (format!("models {model} and {model}Plant"), "cargo fmu simulate loop.toml".into())
        }
        true => (format!("model {model}"), format!("cargo fmu run {model}")),
    };
    writeln!(
        out,
        "wrote the package {name} with the {models}; next:

  cd {shown}
  cargo test
  cargo fmu export
  {simulate}"
    )?;
    if !has_workflow {
        let note = "no workflow was written, because GitHub reads .github at the root of a repository only";
        writeln!(out, "\n{note}")?;
    }
    let is_found = !has_workflow && matches!(package.dependency, Dependency::Folder(_));
    if let Some(caution) = package.dependency.caution().filter(|_| !is_found) {
        writeln!(out, "\n{caution}")?;
    }
    Ok(())
}

/// The name of the model of a package: `MyController` of `my-controller`.
fn model_name(package: &str) -> Result<String> {
    let is_valid = package.starts_with(|c: char| c.is_ascii_alphabetic())
        && package.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c));
    ensure!(
        is_valid,
        "the name {package:?} cannot be used; expected letters, digits, - and _, starting with a letter"
    );
    let words = package.split(['-', '_']).filter(|word| !word.is_empty());
    let model: String = words.map(|word| word[..1].to_uppercase() + &word[1..]).collect();
    ensure!(
        !TAKEN.contains(&model.as_str()),
        "the name {package:?} cannot be used; fmu-export has a {model}, too"
    );
    Ok(model)
}

struct Package<'a> {
    name: &'a str,
    model: &'a str,
    dependency: Dependency,
    parts: Vec<Part>,
}

impl Package<'_> {
    /// Writes the package to a new folder, with a workflow if this is the root of a repository, where GitHub reads it.
    fn create(&mut self, folder: &Path) -> Result<()> {
        let mut parents = folder.ancestors().skip(1);
        let is_in_repository = parents.any(|parent| parent.join(".git").exists());
        // Cargo also checks the name, adds the package to a workspace, and starts a git repository.
        let new = ["new", "--quiet", "--lib", "--name", self.name];
        output(cargo().args(new).arg(folder))?;
        let locate = ["locate-project", "--workspace", "--message-format=plain"];
        let manifest = folder.join("Cargo.toml");
        let root = output(cargo().args(locate).arg("--manifest-path").arg(manifest))?;
        let root = Path::new(root.trim_end()).parent().unwrap_or(folder);
        // The path of the folder may lead through `..`.
        let (root, below) = (root.canonicalize()?, folder.canonicalize()?);
        let below = below.strip_prefix(root).map_or(0, |below| below.components().count());
        if !is_in_repository && below == 0 {
            self.parts.push(Part::Workflow);
        }
        let author = output(Command::new("git").args(["config", "user.name"])).unwrap_or_default();
        let authors = Some(author.trim()).filter(|author| !author.is_empty()).map(quoted);
        let values = [
            ("fmu-export = \"0.1\"", &*self.dependency.to_string()),
            ("authors = []", &format!("authors = [{}]", authors.unwrap_or_default())),
            ("INSTALL", &self.dependency.install()),
            ("target/fmu/", &format!("{}target/fmu/", "../".repeat(below))),
            ("MyController", self.model),
            ("my-controller", self.name),
        ];
        for (file, part, template) in FILES {
            if part.is_some_and(|part| !self.parts.contains(&part)) {
                continue;
            }
            let (path, text) = (folder.join(file), select(template, &self.parts));
            path.parent()
                .map_or(Ok(()), fs::create_dir_all)
                .and_then(|()| fs::write(&path, filled(&text, &values)))
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }
}

fn cargo() -> Command {
    Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Runs a program and returns what it prints.
fn output(command: &mut Command) -> Result<String> {
    let program = command.get_program().display().to_string();
    let output = command.output().with_context(|| format!("cannot run {program}"))?;
    if !output.status.success() {
        let message = String::from_utf8_lossy(&output.stderr);
        bail!("{}", message.trim_start_matches("error: ").trim_end());
    }
    Ok(String::from_utf8(output.stdout)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_is_named_after_its_package() {
        for (package, model) in [
            ("my-controller", "MyController"),
            ("pid", "Pid"),
            ("pid__2-dof_", "Pid2Dof"),
            ("PID", "PID"),
        ] {
            assert_eq!(model_name(package).unwrap(), model);
        }
    }

    #[test]
    fn names_that_are_no_model_are_refused() {
        for package in ["", "1pid", "_", "-pid", "pïd", "a b", "a.b", "driver", "fmu-export"] {
            assert!(model_name(package).is_err(), "{package}");
        }
    }
}
