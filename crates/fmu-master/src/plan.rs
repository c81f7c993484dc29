//! The plan of a run: a loaded and checked system, ready to simulate.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use fmu_description::{Causality, Type, Variable};

use crate::adaptive_plan::AdaptivePlan;
use crate::batches::batches;
use crate::clocked_stage::{self, ClockedStage};
use crate::components::{Components, LoadedComponent, ScalarId, check_tolerance};
use crate::connections::{self, ResolvedConnection};
use crate::container::choice;
use crate::input_table::InputTable;
use crate::iterated_group::Schedule;
use crate::live_input::{self, LiveInput};
use crate::note::Note;
use crate::rate;
use crate::saved_run::{SavedRun, SystemIdentity};
use crate::start::{ComponentStarts, StartValue, scalar_literals};
use crate::store::number;
use crate::table::Column;
use crate::wiring::Wiring;
use crate::{Description, Execution, Experiment, Fmu, Literal, Order, Place, Row, Solver};

/// A system with loaded FMUs and checked connections, start values and recorded variables.
pub struct Plan {
    /// The components, in their order.
    pub components: Components,
    /// The recorded variables, in the order of a row.
    pub columns: Vec<Column>,
    /// The times of a run.
    pub experiment: Experiment,
    /// How a run is executed.
    pub execution: Execution,
    /// The number of communication steps from one recorded row to the next.
    pub(crate) output_every: u64,
    pub(crate) order: Order,
    pub(crate) schedule: Schedule,
    /// The components that may step at the same time.
    pub(crate) batches: Vec<Vec<usize>>,
    pub(crate) adaptive: Option<AdaptivePlan>,
    pub(crate) connections: Vec<ResolvedConnection>,
    /// The output that feeds each connected input.
    sources: HashMap<ScalarId, ScalarId>,
    pub(crate) input: Option<InputTable>,
    /// The rows of the input table, if they arrive while the run goes.
    pub(crate) live: Option<LiveInput>,
    /// The inputs that a host sets, if the system is in a container.
    pub(crate) host_inputs: Vec<ScalarId>,
    pub(crate) wiring: Wiring,
    /// The variables of the columns.
    pub(crate) recorded: Vec<ScalarId>,
    /// The smallest and the largest value of each column that the model description allows.
    pub bounds: Vec<[Option<f64>; 2]>,
    /// Whether there are rows at the ends of the solver's steps, too: of one FMU whose step nobody has chosen.
    pub(crate) records_internal_steps: bool,
    /// The state from which a run begins.
    pub(crate) loaded: Option<SavedRun>,
    /// The file to which the state is saved at the stop time, and the identity of the system.
    pub(crate) save: Option<(PathBuf, SystemIdentity)>,
    /// Choices of the master that the user may want to override.
    notes: Vec<Note>,
}

impl Plan {
    /// Loads the FMUs of a system, each file once, and checks that everything fits.
    ///
    /// # Errors
    /// Something does not fit; the error names it: a file, a variable, a causality, a type, a unit, a
    /// start value, the times, an algebraic loop.
    pub fn new(description: &Description) -> Result<Self> {
        Self::load(description).map_err(|error| match &description.package {
            Some(package) => package.with_package_names(&error),
            None => error,
        })
    }

    fn load(description: &Description) -> Result<Self> {
        let loaded = description.load_state.as_deref().map(SavedRun::read).transpose()?;
        let continued = loaded.as_ref().map(|loaded| Description {
            start: loaded.start,
            step: match description.is_step_derived {
                true => loaded.system.step,
                false => description.step,
            },
            ..description.clone()
        });
        let description = continued.as_ref().unwrap_or(description);
        let experiment = description.experiment();
        experiment.steps()?;
        check_tolerance("tolerance", description.tolerance)?;
        let output_every = output_every(description.output_step, experiment.step)?;
        let mut components = Components::load(description)?;
        let all_connections = connections::resolve(description, &components)?;
        let is_trigger =
            |c: &ResolvedConnection| c.from.variable(&components).of_type == Type::Clock;
        let (triggers, connections) =
            all_connections.iter().cloned().partition::<Vec<_>, _>(is_trigger);
        let fed: HashSet<usize> = connections.iter().map(|c| c.to.component).collect();
        for (index, component) in components.all.iter_mut().enumerate() {
            // The events of an FMU that no other one feeds do not wait for the next step.
            let is_fed = fed.contains(&index);
            component.sampled &= is_fed || !component.is_guess || !component.integrates();
        }
        let is_paced = description.execution.real_time.is_some();
        let is_live = |file: &Path| is_paced && live_input::is_stream(file);
        let mut live = None;
        let Description { given_inputs, input, stimuli, .. } = description;
        let input = match (given_inputs, input, stimuli) {
            (Some(given), _, _) => Some(InputTable::of_values(given, &components, &connections)?),
            (None, Some(file), _) if is_live(file) => {
                let (table, arriving) = LiveInput::open(file, &components, &connections)?;
                live = Some(arriving);
                Some(table)
            }
            (None, Some(file), _) => Some(InputTable::read(file, &components, &connections)?),
            (None, None, Some(stimuli)) => {
                Some(InputTable::of_stimuli(stimuli, &components, &connections)?)
            }
            (None, None, None) => None,
        };
        let host_inputs = match description.is_in_container {
            true => choice::inputs(&description.expose, &components, &connections, input.as_ref())?,
            false => Vec::new(),
        };
        let (recorded, names): (Vec<_>, Vec<_>) =
            recorded(&components, &description.outputs)?.into_iter().unzip();
        let bounds = |id: &ScalarId| {
            let Variable { min, max, .. } = id.variable(&components);
            [min, max].map(|bound| bound.as_ref().map(number))
        };
        let column = |(id, name): (&ScalarId, String)| {
            let variable = id.variable(&components);
            let items = variable.items().iter().map(|item| (item.value, item.name.clone()));
            let (unit, items) = (variable.unit.as_deref().unwrap_or_default(), items.collect());
            // Whether it has ticked.
            let kind = match variable.of_type {
                Type::Clock => Type::Boolean,
                kind => kind,
            };
            // The host of a container always gets a value: the last one.
            let may_be_absent = !description.is_in_container;
            let optional = may_be_absent && kind == variable.of_type && id.is_clocked(&components);
            Column { items, optional, ..Column::new(name, unit, kind) }
        };
        let columns = Vec::from_iter(recorded.iter().zip(names).map(column));
        let wiring = Wiring::new(
            description,
            &components,
            &connections,
            input.as_ref(),
            &host_inputs,
            (&recorded, &columns),
        );
        wiring.extrapolation.check(&components)?;
        let (save, load) = (&description.save_state, &description.load_state);
        ensure!(
            description.step_tolerance.is_none() || (save.is_none() && load.is_none()),
            "a run with step_tolerance can neither be saved nor continued, as the size of its next step is not in the state"
        );
        if save.is_some() {
            components.all.iter().try_for_each(|component| component.check_savable(true))?;
            let last = experiment.steps()? - 1;
            if let Some(component) = components.all.iter().find(|c| !c.rate.is_due(last)) {
                let (name, step, stop) = (&component.name, component.rate.step, experiment.stop);
                bail!(
                    "stop = {stop:?} s is within a step of {name}, {step:?} s; the state can be saved only between its steps"
                );
            }
        }
        let mut identity = None;
        if save.is_some() || load.is_some() {
            let how = (experiment.step, description.order, description.seed);
            identity = Some(SystemIdentity::new(how, &components, &connections)?);
        }
        if let (Some(loaded), Some(identity), Some(file)) = (&loaded, &identity, load) {
            loaded.check(identity).with_context(|| file.display().to_string())?;
            let (time, stop) = (experiment.time(loaded.k), experiment.stop);
            ensure!(
                loaded.k < experiment.steps()?,
                "{}: the state is of t = {time:?} s, expected a stop time from there; got {stop:?} s",
                file.display()
            );
        }
        let save = save.clone().zip(identity);
        let clocked = ClockedStage::new(
            description,
            &components,
            &connections,
            &triggers,
            input.as_ref(),
            &wiring,
        )?;
        let schedule = Schedule::new(description, &components, &connections, clocked, &wiring)?;
        let batches = batches(description.order, &schedule.stages, &connections);
        let is_threaded = description.execution.threads.is_some_and(|threads| threads.get() > 1);
        Ok(Self {
            execution: description.execution.clone(),
            order: description.order,
            adaptive: AdaptivePlan::new(
                description,
                &components,
                &connections,
                &schedule,
                &wiring,
            )?,
            schedule,
            wiring,
            loaded,
            save,
            columns,
            notes: notes(&components, &recorded)
                .into_iter()
                .chain(experiment.note()?)
                .chain(clocked_stage::note(&components, &connections, &triggers, input.as_ref()))
                .chain(
                    (is_threaded && batches.iter().all(|b| b.len() < 2))
                        .then_some(Note::StepsOneByOne),
                )
                .collect(),
            batches,
            bounds: recorded.iter().map(bounds).collect(),
            recorded,
            records_internal_steps: description.is_step_derived
                && description.output_step.is_none()
                && components.all.iter().all(|c| c.integrates() && c.solver == Solver::Implicit),
            experiment,
            output_every,
            input,
            live,
            host_inputs,
            sources: all_connections.iter().map(|c| (c.to, c.from)).collect(),
            components,
            connections: all_connections,
        })
    }

    /// The plan of the description with those of these start values, by `component.variable`, that are sizes of arrays;
    /// [`Plan::start_values`] resolves the others.
    ///
    /// # Errors
    /// A size does not fit.
    pub fn resized(
        self,
        mut description: Description,
        starts: &[(String, Literal)],
    ) -> Result<Self> {
        let sizes = self.sizes(starts);
        if sizes.is_empty() {
            return Ok(self);
        }
        for (name, literal) in sizes {
            let name = self.components.unquoted(name);
            let (component, variable) = self.components.split(&name)?;
            let starts = &mut description.components[component].start;
            starts.insert(variable.to_owned(), literal.clone());
        }
        Self::new(&description)
    }

    /// The start values in a list that make another plan: those of structural parameters, and with them those of arrays,
    /// whose sizes may differ from the ones in the description.
    pub fn sizes<'a>(&self, starts: &'a [(String, Literal)]) -> Vec<&'a (String, Literal)> {
        if !starts.iter().any(|(name, _)| self.is_structural(name)) {
            return Vec::new();
        }
        let is_size =
            |name: &str, literal: &Literal| self.is_structural(name) || literal.is_array();
        starts.iter().filter(|(name, literal)| is_size(name, literal)).collect()
    }

    /// The start values in a list, for [`Plan::simulate`], except for structural parameters.
    ///
    /// # Errors
    /// As [`Plan::start`].
    pub fn start_values(&self, starts: &[(String, Literal)]) -> Result<Vec<StartValue>> {
        let others = starts.iter().filter(|(name, _)| !self.is_structural(name));
        others.map(|(name, literal)| self.start(name, literal)).collect()
    }

    /// Whether a variable, `component.variable`, is a structural parameter.
    fn is_structural(&self, name: &str) -> bool {
        let id = self.components.scalar(&self.components.unquoted(name));
        let causality = id.map(|id| id.variable(&self.components).causality);
        causality.is_ok_and(|causality| causality == Causality::StructuralParameter)
    }

    /// A start value for `component.variable` that replaces the one of the description.
    ///
    /// # Errors
    /// There is no such variable, the value has the wrong type, or another value replaces it.
    pub fn start(&self, name: &str, literal: &Literal) -> Result<StartValue> {
        let name = &*self.components.unquoted(name);
        let (component, variable) = self.components.split(name)?;
        let fmu = &self.components[component].fmu;
        let literals = scalar_literals(fmu, variable, name, literal)?.into_iter();
        let values = literals.map(|literal| {
            let id = ScalarId { component, scalar: literal.scalar };
            self.check_free(id, &literal.name, &literal.literal)?;
            Ok((id.scalar, literal.start_value(fmu)?))
        });
        Ok(StartValue { component, values: values.collect::<Result<_>>()? })
    }

    /// Checks that a start value has an effect in a single run.
    fn check_free(&self, id: ScalarId, name: &str, literal: &Literal) -> Result<()> {
        if let Some(from) = self.sources.get(&id) {
            let from = from.name(&self.components);
            bail!("{name} = {literal} has no effect, as {from} is connected to it");
        }
        let table = self.input.iter().filter(|_| self.live.is_none());
        let has_column = table.flat_map(InputTable::scalars).any(|fed| fed == id);
        ensure!(
            !has_column,
            "{name} = {literal} has no effect, as the table of inputs has a column for it"
        );
        ensure!(
            id.variable(&self.components).causality != Causality::StructuralParameter,
            "{name} = {literal} cannot be set for single runs, as it is the size of arrays; expected it in the start values of the system"
        );
        Ok(())
    }

    /// The start values of a component: as in the description, unless `replaced` by start values of the run.
    pub(crate) fn starts<'a>(
        &'a self,
        component: usize,
        replaced: &'a [StartValue],
    ) -> Result<ComponentStarts<'a>> {
        let loaded = &self.components[component];
        let replaced = replaced.iter().filter(|start| start.component == component);
        let values = loaded.starts.iter().chain(replaced.flat_map(|start| &start.values));
        let mut starts = ComponentStarts::new(values);
        if let (Some(table), None) = (&self.input, &self.live) {
            starts.replace(
                table.parameters_at(component, self.last_setting(component, self.first())),
            );
        }
        starts.check_arrays(&loaded.fmu, |scalar| loaded.name_of(scalar))?;
        Ok(starts)
    }

    /// The notes of a run with these start values, which name the deprecated variables that it uses.
    pub fn notes(&self, starts: &[StartValue]) -> Vec<Note> {
        let of_system = self.components.iter().enumerate();
        let of_system = of_system.map(|(index, component)| (index, &component.starts));
        let set = of_system.chain(starts.iter().map(|start| (start.component, &start.values)));
        let set = set.flat_map(|(component, values)| {
            values.iter().map(move |(scalar, _)| ScalarId { component, scalar: *scalar })
        });
        let connected = self.connections.iter().flat_map(|c| [c.from, c.to]);
        let fed = self.input.iter().flat_map(InputTable::scalars);
        let (mut notes, mut known) = (self.notes.clone(), HashSet::new());
        for id in connected.chain(fed).chain(set) {
            let first = id.fmu(&self.components).first(id.scalar);
            let variable = id.variable(&self.components);
            if let Some(instead) = variable.deprecated()
                && known.insert((id.component, first))
            {
                let (variable, instead) = (id.name(&self.components), instead.to_owned());
                notes.push(Note::Deprecated { variable, instead });
            }
        }
        notes
    }

    /// The names of the components and of their files, for [`RunError::crash`](crate::RunError::crash).
    pub fn names(&self) -> Vec<(String, String)> {
        let names = self.components.iter().map(|c| (c.name.clone(), c.fmu.file_name()));
        names.collect()
    }

    /// The place in a row of a recorded variable.
    ///
    /// # Errors
    /// It is not recorded.
    pub fn place(&self, name: &str) -> Result<Place> {
        let places = Row::places(&self.columns);
        let mut named = self.columns.iter().zip(places);
        let place = named.find_map(|(column, place)| (column.name == name).then_some(place));
        place.with_context(|| format!("{name} is not recorded"))
    }

    /// The stop time of the FMUs: the one of the run, or one step later if there are sampled components,
    /// whose last row belongs to a step from the stop time.
    pub fn end(&self) -> f64 {
        let Experiment { stop, step, .. } = self.experiment;
        if self.steps_from_stop() { stop + step } else { stop }
    }

    /// The stop time of the FMU of a component: a sampled one with a step of its own may end its last step later.
    pub(crate) fn end_of(&self, component: usize) -> f64 {
        let LoadedComponent { rate, sampled, .. } = self.components[component];
        let (end, start) = (self.end(), self.experiment.start);
        match self.communication_steps().checked_sub(1) {
            Some(last) if sampled && rate.every > 1 => {
                let last = last - last % rate.every;
                let ends = rate.times(last + rate.every, start);
                ends.filter(|time| *time - end > 1e-6 * self.experiment.step).fold(end, f64::max)
            }
            _ => end,
        }
    }

    /// The number of communication steps of a run, one of which may be from the stop time.
    pub(crate) fn communication_steps(&self) -> u64 {
        // Checked when the plan was made.
        let points = self.experiment.steps().unwrap_or(0);
        if self.steps_from_stop() { points } else { points.saturating_sub(1) }
    }

    /// Whether a step from the stop time is needed, because a recorded component is sampled, or one that feeds a component
    /// with clocks.
    pub(crate) fn steps_from_stop(&self) -> bool {
        !self.wiring.recorded_after.is_empty() || self.wiring.samples_at_ticks
    }
}

/// The number of communication steps (s) from one recorded row to the next.
fn output_every(output_step: Option<f64>, communication_step: f64) -> Result<u64> {
    let Some(output_step) = output_step else { return Ok(1) };
    rate::ratio(output_step, communication_step).with_context(|| {
        format!("output_step = {output_step:?}, expected a multiple of the communication step, {communication_step:?} s")
    })
}

/// The recorded variables, and the names of their columns: a variable may be recorded by its name and aliases.
fn recorded(components: &Components, names: &[String]) -> Result<Vec<(ScalarId, String)>> {
    if names.is_empty() {
        // Strings, Binaries and clocks only on request.
        let is_recorded = |id: &ScalarId| {
            let variable = id.variable(components);
            variable.causality == Causality::Output
                && !matches!(variable.of_type, Type::String | Type::Binary | Type::Clock)
                && unusable(components, id).is_none()
        };
        let recorded = components.scalars().filter(is_recorded);
        return Ok(recorded.map(|id| (id, id.name(components))).collect());
    }
    let (mut ids, mut found) = (Vec::new(), HashSet::new());
    for name in names {
        let (component, scalars) = components.lookup(name, Fmu::scalars_of)?;
        let LoadedComponent { prefix, fmu, .. } = &components[component];
        for scalar in scalars {
            let id = ScalarId { component, scalar };
            if let Some(reason) = unusable(components, &id) {
                bail!("{name} cannot be recorded: {reason}");
            }
            let name = format!("{prefix}{}", fmu.name_as(&name[prefix.len()..], scalar));
            ensure!(found.insert(name.clone()), "{name} is recorded twice");
            ids.push((id, name));
        }
    }
    Ok(ids)
}

/// The number of variables that a note names.
const NAMED: usize = 8;

/// Which components were taken for sampled ones, and what could be recorded if nothing is.
fn notes(components: &Components, recorded: &[ScalarId]) -> Vec<Note> {
    let mut notes = Vec::new();
    let named = |is_named: &dyn Fn(usize, &LoadedComponent) -> bool| {
        let all = components.iter().enumerate();
        let named = all.filter(|(index, component)| is_named(*index, component));
        Vec::from_iter(named.map(|(_, component)| component.name.clone()))
    };
    let are_recorded: HashSet<usize> = recorded.iter().map(|id| id.component).collect();
    let guessed = named(&|index, component| {
        component.sampled && component.is_guess && are_recorded.contains(&index)
    });
    if !guessed.is_empty() {
        notes.push(Note::RecordedAfterStep(guessed));
    }
    let in_sandbox = named(&|_, component| component.fmu.is_component());
    if !in_sandbox.is_empty() {
        notes.push(Note::RunInSandbox(in_sandbox));
    }
    let compiled = named(&|_, component| component.fmu.compiled().is_some());
    if !compiled.is_empty() {
        let fmus = components.iter().filter_map(|component| component.fmu.compiled());
        let mut left_out = Vec::from_iter(fmus.flatten().cloned());
        left_out.dedup();
        notes.push(Note::Compiled { components: compiled, left_out });
    }
    let with_ignored = components.iter().filter(|component| !component.ignored.is_empty());
    notes.extend(with_ignored.map(|component| Note::ParametersIgnored {
        component: component.name.clone(),
        names: component.ignored.clone(),
    }));
    if recorded.is_empty() {
        let mut all =
            Vec::from_iter(components.scalars().filter(|p| unusable(components, p).is_none()));
        all.sort_by_key(|id| id.variable(components).causality != Causality::Output);
        let recordable = all.iter().take(NAMED).map(|id| {
            let kind = id.variable(components).of_type;
            let version = id.fmu(components).version;
            format!("{} ({})", id.name(components), kind.name(version))
        });
        let more = all.len().saturating_sub(NAMED);
        notes.push(Note::NothingRecorded { recordable: recordable.collect(), more });
    }
    notes
}

fn unusable(components: &[LoadedComponent], id: &ScalarId) -> Option<&'static str> {
    id.fmu(components).unusable(id.scalar)
}
