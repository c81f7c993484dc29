//! The packages: which systems, and what is in the archive of each.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use fmu_cosim::{Description, Order, Plan};
use fmu_file::archive::{self, Entry, Packed};
use fmu_file::replace;

use super::resources::Resources;
use super::{Options, structure};

/// The loops of the paper, as tools that step in parallel bear them.
const LOOPS: [(&str, &str); 4] = [
    (
        "examples/ssp/pid.toml",
        include_str!("../../../../../examples/ssp/pid.toml"),
    ),
    (
        "examples/ssp/pid-rbf.toml",
        include_str!("../../../../../examples/ssp/pid-rbf.toml"),
    ),
    (
        "examples/ssp/ipid-rbf.toml",
        include_str!("../../../../../examples/ssp/ipid-rbf.toml"),
    ),
    (
        "examples/ssp/supervised.toml",
        include_str!("../../../../../examples/ssp/supervised.toml"),
    ),
];

/// A package that can be written.
struct Package {
    file: PathBuf,
    structure: String,
    resources: Resources,
    order: Order,
}

/// Writes the packages, once all of them are known to fit.
///
/// # Errors
/// What does not fit in a system, as `simulate` says it; the folder cannot be written to.
pub fn run(options: &Options, out: &mut impl Write) -> Result<()> {
    let systems = systems(options)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("cannot make the folder {}", options.out.display()))?;
    replace::check_writable(&options.out)?;
    let mut packages: Vec<Package> = Vec::new();
    for (file, description) in systems {
        let package = package(&file, &description, &options.out)
            .with_context(|| file.display().to_string())?;
        ensure!(
            packages.iter().all(|other| other.file != package.file),
            "two of the systems would be written to {}",
            package.file.display()
        );
        packages.push(package);
    }
    for package in &packages {
        let size = package.write()?;
        let file = package.file.display();
        writeln!(out, "{file}  {} KB", size.div_ceil(1000))?;
        if package.order == Order::Sequential {
            eprintln!(
                "warning: {file} cannot say that the system steps in sequential order; most tools step in parallel"
            );
        }
    }
    Ok(())
}

/// The systems, and the files that describe them.
fn systems(options: &Options) -> Result<Vec<(PathBuf, Description)>> {
    if options.systems.is_empty() {
        let folder = options.fmus.as_deref();
        return loops(folder.unwrap_or(Path::new("target/fmu")));
    }
    let read = |file: &PathBuf| {
        let mut description = Description::read(file)?;
        if let Some(folder) = &options.fmus {
            description.take_fmus_from(folder);
        }
        Ok((file.clone(), description))
    };
    options.systems.iter().map(read).collect()
}

fn loops(fmus: &Path) -> Result<Vec<(PathBuf, Description)>> {
    ensure!(
        fmus.is_dir(),
        "there is no folder {}; `cargo fmu export` writes the FMUs to target/fmu",
        fmus.display()
    );
    let read = |(file, text): (&str, &str)| {
        let mut description = Description::parse(text).context(file.to_owned())?;
        description.take_fmus_from(fmus);
        Ok((file.into(), description))
    };
    LOOPS.into_iter().map(read).collect()
}

fn package(file: &Path, description: &Description, folder: &Path) -> Result<Package> {
    let plan = Plan::new(description)?;
    // The FMUs themselves say which start values they take.
    plan.simulate(&[])?;
    let mut resources = Resources::default();
    let places = plan
        .components()
        .iter()
        .map(|component| resources.add(&component.fmu.path))
        .collect::<Result<Vec<_>>>()?;
    let name = file.file_stem().unwrap_or_default().to_string_lossy();
    Ok(Package {
        structure: structure::document(&name, description, &plan, &places)?,
        file: folder.join(format!("{name}.ssp")),
        resources,
        order: description.order,
    })
}

impl Package {
    fn write(&self) -> Result<u64> {
        let structure = Packed::text(self.structure.as_bytes())?;
        let entries: Vec<_> = [Entry::new("SystemStructure.ssd", &structure)]
            .into_iter()
            .chain(self.resources.entries())
            .collect();
        archive::write(&self.file, &entries)
    }
}
