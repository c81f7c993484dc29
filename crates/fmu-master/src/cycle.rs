//! The calls of a step of an FMU that is not connected to others: it sets variables, steps and gets variables, which are looked
//! up once.

use fmu_description::{Type, Value};
use fmu_host::InterfaceType;
use fmu_worker::Function;

use crate::Fmu;
use crate::access_list::{AccessList, accessor};
use crate::component_instance::{CallResult, ComponentInstance};
use crate::recorded_instance::RecordedInstance;
use crate::store::number;

/// What a step sets and gets. All variables are Float64, and the FMU takes the step itself.
pub(crate) struct Cycle {
    inputs: AccessList,
    outputs: AccessList,
    functions: [Option<Function>; 3],
}

impl Cycle {
    /// The step of an FMU that sets and gets these scalars; `None` if that needs other calls.
    pub(crate) fn new(fmu: &Fmu, inputs: &[usize], outputs: &[usize]) -> Option<Self> {
        let list = |scalars: &[usize]| {
            let are_floats = scalars.iter().all(|s| fmu.access_type(*s) == Type::Float64);
            let list = are_floats.then(|| AccessList::new(fmu, scalars.iter().copied()))?;
            list.is_complete.then_some(list)
        };
        let accessor = |verb| accessor(verb, fmu.version, Type::Float64);
        let do_step = Function::performing(fmu.version, "do_step");
        let is_stepped = fmu.interface_type == InterfaceType::CoSimulation;
        Some(Self {
            inputs: list(inputs).filter(|_| is_stepped)?,
            outputs: list(outputs)?,
            functions: [accessor("set"), do_step, accessor("get")],
        })
    }
}

impl ComponentInstance<'_> {
    /// Says which variables [`ComponentInstance::perform`] sets and gets.
    pub(crate) fn prepare(&mut self, cycle: &Cycle) {
        let [set, get] = [&cycle.inputs, &cycle.outputs].map(|list| list.placed_at(0));
        self.recorded.instance.access_at_steps(set, get);
    }

    /// Makes the calls of a cycle for which it is prepared.
    pub(crate) fn perform(
        &mut self,
        cycle: &Cycle,
        inputs: &[f64],
        (time, step): (f64, f64),
        outputs: &mut [f64],
    ) -> CallResult {
        let RecordedInstance { instance, calls, .. } = &mut self.recorded;
        let begin = |call: usize| calls.continue_call(cycle.functions[call]);
        let (done, outcome) = instance.cycle(Some(inputs), time, step, outputs, begin);
        if (done, &outcome) == (3, &None) {
            return Ok(());
        }
        self.finish(cycle, (done, outcome.map(|outcome| *outcome)), inputs, (time, step), outputs)
    }

    /// Makes the rest of the calls, after some are done of which the last one has this outcome.
    #[cold]
    fn finish(
        &mut self,
        cycle: &Cycle,
        (done, outcome): (usize, Option<fmu_host::Result>),
        inputs: &[f64],
        (time, step): (f64, f64),
        outputs: &mut [f64],
    ) -> CallResult {
        let values = Vec::from_iter(inputs.iter().map(|value| Value::Float64(*value)));
        let Cycle { inputs, outputs: list, functions } = cycle;
        match (done, outcome) {
            (_, None) => {}
            (1, Some(outcome)) => self.check_writing(outcome, inputs, &values)?,
            (2, Some(outcome)) => self.check_step(outcome, time, step)?,
            (_, Some(outcome)) => self.check_reading(outcome, list)?,
        }
        if done < 1 {
            self.set(Type::Float64, functions[0], inputs, &values)?;
        }
        if done < 2 {
            self.step::<true>(time, step)?;
        }
        if done < 3 {
            let got = self.get(Type::Float64, functions[2], list)?;
            outputs.iter_mut().zip(&got).for_each(|(to, value)| *to = number(value));
        }
        Ok(())
    }
}
