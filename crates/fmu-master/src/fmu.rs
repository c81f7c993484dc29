//! An unpacked FMU: its variables and units, which are found by their names, and its instances.

pub(crate) mod files;
mod jacobian;
mod open;

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use fmu_description::{Causality, FmiVersion, Type, Value, Variable};
use fmu_file::archive::{TERMINALS, read_ssp};
use fmu_host::{Instance, InterfaceType};

pub(crate) use self::jacobian::JacobianStructure;
use crate::code::{Code, UnpackedBinary};
use crate::declarations::Units;
use crate::similar::similar;
use crate::terminals::{self, Terminal};
use crate::{Advice, Function, Messages};

/// An FMU for co-simulation or model exchange.
pub struct Fmu {
    /// The file.
    pub path: PathBuf,
    /// Its version of FMI.
    pub version: FmiVersion,
    /// Its variables, in the order of the model description.
    pub variables: Vec<Variable>,
    /// Its scalar variables and the elements of its arrays, which follow each other.
    pub(crate) scalars: Vec<Scalar>,
    /// Outputs, and the inputs that they depend on directly, where the FMU declares it; an array stands for its first
    /// element.
    pub(crate) feedthrough: HashMap<usize, Vec<usize>>,
    /// The indices of scalars by their names and aliases.
    index: HashMap<String, usize>,
    /// For scalars that are set through another one, the index of that scalar.
    settable: HashMap<usize, usize>,
    /// The indices of the elements of arrays by their names and aliases.
    arrays: HashMap<String, Range<usize>>,
    units: Units,
    /// The tolerance of its default experiment.
    pub(crate) tolerance: Option<f64>,
    /// The step size of its default experiment (s).
    pub(crate) step: Option<f64>,
    /// How it is run.
    pub(crate) interface_type: InterfaceType,
    /// In FMI 2.0, the number of continuous states and of event indicators.
    pub(crate) equations: [usize; 2],
    code: Code,
    /// Whether a process can have only one instance of the FMU.
    pub(crate) only_once: bool,
    /// Whether it has event mode in co-simulation, and whether it has clocks that a host ticks or gets, which need event
    /// mode.
    pub(crate) has_event_mode: bool,
    pub(crate) has_clocks: bool,
    /// Whether its steps may return early, and whether it has `fmi3EvaluateDiscreteStates`.
    pub(crate) may_return_early: bool,
    pub(crate) evaluates_discrete_states: bool,
    /// The highest order of the derivatives of its outputs, in co-simulation.
    pub(crate) output_derivatives: usize,
    /// Whether it takes derivatives of its inputs, which only FMI 2.0 has.
    pub(crate) interpolates_inputs: bool,
    /// The nominal values of variables that have one, by their indices.
    nominals: HashMap<usize, f64>,
    /// The names of the continuous states and their derivatives.
    pub(crate) states: Vec<[String; 2]>,
    pub(crate) jacobian: JacobianStructure,
    /// Whether it provides directional derivatives when it is run in this way.
    pub(crate) is_directional: bool,
    /// Whether its states can be saved and restored, when it is run in this way.
    pub(crate) saves: Saves,
}

/// A scalar variable, or an element of an array.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scalar {
    /// The index of the variable.
    pub(crate) variable: usize,
    /// Its index in the array.
    pub(crate) element: usize,
}

/// Whether states can be saved in memory, and as bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Saves {
    pub(crate) in_memory: bool,
    pub(crate) in_file: bool,
}

/// Values of structural parameters by their names.
pub(crate) type Sizes = BTreeMap<String, i128>;

impl Fmu {
    /// A function with these variables; the path stands for it in messages.
    pub(crate) fn from_function(
        path: &Path,
        function: &Function,
        variables: Vec<Variable>,
    ) -> Self {
        let names = variables.iter().map(|variable| variable.name.clone());
        Self {
            path: path.to_owned(),
            version: FmiVersion::Fmi3,
            scalars: (0..variables.len()).map(|variable| Scalar { variable, element: 0 }).collect(),
            index: names.zip(0..).collect(),
            settable: HashMap::new(),
            arrays: HashMap::new(),
            variables,
            feedthrough: HashMap::new(),
            nominals: HashMap::new(),
            units: Units::new(),
            tolerance: None,
            step: None,
            interface_type: InterfaceType::CoSimulation,
            equations: [0; 2],
            code: Code::Function(function.clone()),
            only_once: false,
            has_event_mode: false,
            has_clocks: false,
            may_return_early: false,
            evaluates_discrete_states: false,
            output_derivatives: 0,
            interpolates_inputs: false,
            states: Vec::new(),
            jacobian: JacobianStructure::default(),
            is_directional: false,
            saves: Saves { in_memory: false, in_file: false },
        }
    }

    /// The terminals.
    ///
    /// # Errors
    /// Their file cannot be read.
    pub(crate) fn terminals(&self) -> Result<Vec<Terminal>> {
        let Code::Binary(binary) = &self.code else { return Ok(Vec::new()) };
        let file = binary.folder.path().join(TERMINALS);
        match file.exists() {
            true => terminals::read(&read_ssp(&file)?),
            false => Ok(Vec::new()),
        }
    }

    /// Whether the master activates its model partitions.
    pub(crate) fn is_scheduled(&self) -> bool {
        self.interface_type == InterfaceType::ScheduledExecution
    }

    /// Whether it runs as a WebAssembly component.
    pub(crate) fn is_component(&self) -> bool {
        matches!(&self.code, Code::Binary(binary) if binary.is_component())
    }

    /// Whether it is a function of this program.
    pub(crate) fn is_function(&self) -> bool {
        matches!(&self.code, Code::Function(_))
    }

    /// Its GUID or instantiation token.
    pub(crate) fn token(&self) -> &str {
        match &self.code {
            Code::Binary(binary) => &binary.token,
            Code::Function(_) => "",
        }
    }

    /// If it was compiled from its sources, what was left out of its build description.
    pub(crate) fn compiled(&self) -> Option<&[String]> {
        match &self.code {
            Code::Binary(binary) => binary.compiled.as_deref(),
            Code::Function(_) => None,
        }
    }

    /// The value reference of a variable, if it is accessed by this type or all types share the references.
    pub(crate) fn reference(&self, name: &str, access: Option<Type>) -> Option<u32> {
        let scalar = self.index.get(name).copied();
        let scalar = scalar.or_else(|| self.arrays.get(name).map(|elements| elements.start))?;
        let is_same = access.is_none_or(|access| self.access_type(scalar) == access);
        is_same.then(|| self.variable(scalar).reference)
    }

    /// Its binary, unless it is a function.
    pub(crate) fn binary(&self) -> Option<&UnpackedBinary> {
        match &self.code {
            Code::Binary(binary) => Some(binary),
            Code::Function(_) => None,
        }
    }

    /// Whether it must not be called again in this process, because of a fatal error.
    pub(crate) fn is_lost(&self) -> bool {
        matches!(&self.code, Code::Binary(binary) if binary.is_lost())
    }

    /// Its file name.
    pub fn file_name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// The variable of a scalar.
    pub(crate) fn variable(&self, scalar: usize) -> &Variable {
        &self.variables[self.scalars[scalar].variable]
    }

    /// The name of a scalar, with an index if it is an element of an array.
    pub(crate) fn name(&self, scalar: usize) -> String {
        let variable = self.variable(scalar);
        variable.element_name(&variable.name, self.scalars[scalar].element)
    }

    /// The name of a scalar that was found by this name, which may be an alias or the name of its array.
    pub(crate) fn name_as(&self, found: &str, scalar: usize) -> String {
        match self.arrays.contains_key(found) {
            true => self.variable(scalar).element_name(found, self.scalars[scalar].element),
            false => found.to_owned(),
        }
    }

    /// The scalars of the array that a scalar is an element of.
    pub(crate) fn array(&self, scalar: usize) -> Range<usize> {
        let first = self.first(scalar);
        first..first + self.variable(scalar).element_count()
    }

    /// The first of these.
    pub(crate) fn first(&self, scalar: usize) -> usize {
        scalar - self.scalars[scalar].element
    }

    /// The nominal value of a scalar, a positive number; 1 if it has none.
    pub(crate) fn nominal(&self, scalar: usize) -> f64 {
        self.nominals.get(&self.scalars[scalar].variable).copied().unwrap_or(1.0)
    }

    /// The start value of a scalar in the model description.
    pub(crate) fn start(&self, scalar: usize) -> Option<&Value> {
        self.variable(scalar).start_of(self.scalars[scalar].element)
    }

    /// The type whose functions get and set a scalar.
    pub(crate) fn access_type(&self, scalar: usize) -> Type {
        self.variable(scalar).of_type.accessed_as(self.version)
    }

    /// Why the master can neither record, connect nor set a scalar, if so.
    pub(crate) fn unusable(&self, scalar: usize) -> Option<&'static str> {
        let is_of_ticks = self.variable(scalar).is_of_ticks();
        (is_of_ticks && !self.has_event_mode && !self.is_scheduled())
            .then_some("clocks tick only in co-simulation with event mode (hasEventMode)")
    }

    /// The clocks that a host ticks or gets.
    pub(crate) fn clocks(&self) -> impl Iterator<Item = usize> {
        let is_clock = |variable: &Variable| {
            variable.of_type == Type::Clock
                && matches!(variable.causality, Causality::Input | Causality::Output)
        };
        (0..self.scalars.len()).filter(move |scalar| is_clock(self.variable(*scalar)))
    }

    /// The clock with a value reference.
    pub(crate) fn clock(&self, reference: u32) -> Option<usize> {
        self.clocks().find(|clock| self.variable(*clock).reference == reference)
    }

    /// The index of a scalar, if there is one of this name.
    pub(crate) fn get_scalar(&self, name: &str) -> Option<usize> {
        self.index.get(name).copied()
    }

    /// The index of a scalar.
    ///
    /// # Errors
    /// There is no such variable; the error names similar ones.
    pub(crate) fn scalar(&self, name: &str) -> Result<usize> {
        if let Some(index) = self.get_scalar(name) {
            return Ok(index);
        }
        let names = Vec::from_iter((0..self.scalars.len()).map(|scalar| self.name(scalar)));
        let similar = similar(name, names.iter().map(String::as_str));
        let text = format!("{} has no variable {name}; ", self.file_name());
        if let Some(elements) = self.arrays.get(name) {
            let ends = [elements.start, elements.end - 1].map(|scalar| self.name_as(name, scalar));
            bail!("{text}its elements are {} to {}", ends[0], ends[1]);
        }
        match similar.as_slice() {
            [] => Err(Advice::ListVariables(self.file_name()).after(text)),
            names => bail!("{text}did you mean {}?", names.join(" or ")),
        }
    }

    /// The index of the scalar that is set by this name: of the scalar itself, or of an alias that can be set.
    ///
    /// # Errors
    /// As [`Self::scalar`].
    pub(crate) fn settable(&self, name: &str) -> Result<usize> {
        let scalar = self.scalar(name)?;
        Ok(self.settable.get(&scalar).copied().unwrap_or(scalar))
    }

    /// The indices of the elements of the array of this name, if there is one.
    pub(crate) fn array_of(&self, name: &str) -> Option<Range<usize>> {
        self.arrays.get(name).cloned()
    }

    /// The indices of a scalar, or of all elements of an array.
    ///
    /// # Errors
    /// As [`Self::scalar`].
    pub(crate) fn scalars_of(&self, name: &str) -> Result<Range<usize>> {
        match self.arrays.get(name) {
            Some(elements) => Ok(elements.clone()),
            None => self.scalar(name).map(|scalar| scalar..scalar + 1),
        }
    }

    /// The scalars that are set by this name, and the dimensions of the variable: a scalar, or the elements of an array,
    /// which FMI 2.0 describes one by one.
    ///
    /// # Errors
    /// As [`Self::scalar`].
    pub(crate) fn elements(&self, name: &str) -> Result<(Vec<usize>, Vec<usize>)> {
        if let Some(elements) = self.arrays.get(name) {
            let dimensions = self.variable(elements.start).dimensions.clone();
            return Ok((Vec::from_iter(elements.clone()), dimensions));
        }
        let family = |indices: &dyn Fn(usize) -> String| {
            let element = |index| self.get_scalar(&format!("{name}[{}]", indices(index)));
            Vec::from_iter((1..).map_while(element))
        };
        if self.get_scalar(name).is_none() {
            let vector = family(&|index| index.to_string());
            if !vector.is_empty() {
                return Ok((vector.clone(), vec![vector.len()]));
            }
            let row = |row: usize| family(&|column| format!("{row},{column}"));
            let rows = Vec::from_iter((1..).map(row).take_while(|row| !row.is_empty()));
            if let Some(first) = rows.first()
                && rows.iter().all(|row| row.len() == first.len())
            {
                return Ok((rows.concat(), vec![rows.len(), first.len()]));
            }
        }
        Ok((vec![self.settable(name)?], Vec::new()))
    }

    /// The definition of a unit in base units, if the FMU has one: exponents, factor and offset by name,
    /// without default values.
    pub fn unit(&self, name: &str) -> Option<&[(String, f64)]> {
        self.units.get(name).map(Vec::as_slice)
    }

    /// Whether a unit of this FMU equals one of another FMU, by name or by definition in base
    /// units.
    pub(crate) fn same_unit(&self, unit: &str, other: &Self, of_other: &str) -> bool {
        unit == of_other
            || matches!(
                (self.unit(unit), other.unit(of_other)),
                (Some(a), Some(b)) if a == b
            )
    }

    /// Creates the instance of the component with an index and a name, which logs to the messages of its simulation, and
    /// whose events the host handles in event mode or not.
    ///
    /// # Errors
    /// The binary cannot be loaded or the FMU returns an error; its message is included.
    pub(crate) fn instantiate(
        &self,
        component: (usize, &str),
        event_mode: bool,
        messages: &Messages,
    ) -> Result<Instance> {
        let instance = match &self.code {
            Code::Binary(binary) => binary.instantiate(component, event_mode, messages),
            Code::Function(function) => {
                Ok(function.instantiate(component, &self.variables, messages))
            }
        };
        let (path, (_, name)) = (self.path.display(), component);
        instance.with_context(|| format!("component {name}: {path} cannot be instantiated"))
    }
}
