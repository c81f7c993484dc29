//! The packages: which systems, and what is in the archive of each.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use cosim::{Description, Order, Plan};
use fmu_file::archive::{self, Entry, Packed};
use fmu_file::replace;

use super::resources::Resources;
use super::{Options, structure};

/// The loops of the paper, as tools that step in parallel bear them.
const LOOPS: [(&str, &str); 4] = [
    (
        "examples/ssp/pid.toml",
        include_str!("../../../../examples/ssp/pid.toml"),
    ),
    (
        "examples/ssp/pid-rbf.toml",
        include_str!("../../../../examples/ssp/pid-rbf.toml"),
    ),
    (
        "examples/ssp/ipid-rbf.toml",
        include_str!("../../../../examples/ssp/ipid-rbf.toml"),
    ),
    (
        "examples/ssp/supervised.toml",
        include_str!("../../../../examples/ssp/supervised.toml"),
    ),
];

/// Where the FMUs of these loops are, as seen from the folder of their files.
const FMUS_OF_LOOPS: &str = "target/fmu";

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
    fs::create_dir_all(&options.out)
        .with_context(|| format!("cannot make the folder {}", options.out.display()))?;
    replace::check_writable(&options.out)?;
    let mut packages: Vec<Package> = Vec::new();
    for (file, description) in systems(options)? {
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
    let mut systems = Vec::new();
    for file in &options.systems {
        systems.push((file.clone(), Description::read(file)?));
    }
    if systems.is_empty() {
        for (file, text) in LOOPS {
            let mut description = Description::parse(text).context(file)?;
            description.take_fmus_from(Path::new(FMUS_OF_LOOPS));
            systems.push((file.into(), description));
        }
    }
    if let Some(folder) = &options.fmus {
        for (_, description) in &mut systems {
            description.take_fmus_from(folder);
        }
    }
    Ok(systems)
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
