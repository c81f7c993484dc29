//! Inputs that are extrapolated by the derivatives of the outputs that feed them (FMI 2.0.5, section 4.2.2; FMI 3.0.2,
//! section 4.1.2).
//!
//! The derivatives are in the store with the outputs, and with the time at which the FMU had both.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

use anyhow::{Result, ensure};
use fmu_description::{Type, Variability};

use crate::components::{LoadedComponent, ScalarId};
use crate::connections::ResolvedConnection;
use crate::rate::Inputs;
use crate::store::{Place, Store};

/// The derivatives that are got of the outputs of a component.
#[derive(Default)]
pub(crate) struct OutputDerivatives {
    pub(crate) references: Vec<u32>,
    pub(crate) orders: Vec<i32>,
    /// Where they are in the store, and where their time is (s).
    pub(crate) place: Range<usize>,
    pub(crate) time: usize,
}

/// An input that is extrapolated, and the output that feeds it, by their indices among the numbers of the store.
pub(crate) struct ExtrapolatedInput {
    from: usize,
    /// The derivatives of the output, from the first one, and their time (s).
    derivatives: Range<usize>,
    time: usize,
    pub(crate) to: usize,
    pub(crate) reference: u32,
    /// The factor of the connection.
    pub(crate) factor: f64,
}

/// The derivatives and the extrapolated inputs of each component.
pub(crate) struct Extrapolation {
    pub(crate) outputs: Vec<OutputDerivatives>,
    pub(crate) inputs: Vec<Vec<ExtrapolatedInput>>,
    /// The places of the derivatives of each output.
    places: HashMap<ScalarId, Range<usize>>,
}

impl Extrapolation {
    /// Finds the derivatives that are needed, and their places, which are counted.
    pub(crate) fn new(
        components: &[LoadedComponent],
        connections: &[ResolvedConnection],
        counts: &mut [usize; 2],
    ) -> Self {
        let mut needed: BTreeMap<usize, Vec<ScalarId>> = BTreeMap::new();
        let mut places = HashMap::new();
        for connection in connections.iter().filter(|c| is_extrapolated(components, c)) {
            if places.insert(connection.from, 0..0).is_none() {
                needed.entry(connection.from.component).or_default().push(connection.from);
            }
        }
        let mut outputs = Vec::new();
        outputs.resize_with(components.len(), OutputDerivatives::default);
        let [reals, _] = counts;
        for (component, ids) in needed {
            let derivatives = &mut outputs[component];
            derivatives.time = *reals;
            *reals += 1;
            derivatives.place = *reals..*reals;
            for id in ids {
                let order = id.fmu(components).output_derivatives;
                let reference = id.variable(components).reference;
                derivatives.references.extend((0..order).map(|_| reference));
                derivatives.orders.extend(1..=order as i32);
                places.insert(id, *reals..*reals + order);
                *reals += order;
            }
            derivatives.place.end = *reals;
        }
        let inputs = components.iter().map(|_| Vec::new()).collect();
        Self { outputs, inputs, places }
    }

    /// The place from which the input of a connection gets its value, if it is extrapolated from a place; it is counted.
    pub(crate) fn extrapolate(
        &mut self,
        components: &[LoadedComponent],
        connection: &ResolvedConnection,
        from: Place,
        counts: &mut [usize; 2],
    ) -> Option<Place> {
        let Place::Real(from) = from else { return None };
        let ResolvedConnection { from: output, to: input, conversion, .. } = connection;
        let derivatives = self.places.get(output)?.clone();
        if !is_extrapolated(components, connection) {
            return None;
        }
        self.inputs[input.component].push(ExtrapolatedInput {
            from,
            derivatives,
            time: self.outputs[output.component].time,
            to: counts[0],
            reference: input.variable(components).reference,
            factor: conversion.map_or(1.0, |conversion| conversion.factor),
        });
        Some(Place::next(Type::Float64, counts))
    }

    /// Checks that a component that wants extrapolated inputs has some.
    ///
    /// # Errors
    /// It has none.
    pub(crate) fn check(&self, components: &[LoadedComponent]) -> Result<()> {
        for (component, inputs) in components.iter().zip(&self.inputs) {
            ensure!(
                component.inputs == Inputs::Held || !inputs.is_empty(),
                "component {}: inputs = \"extrapolated\", but no continuous output that feeds it has derivatives (maxOutputDerivativeOrder)",
                component.name
            );
        }
        Ok(())
    }

    /// Whether no input is extrapolated.
    pub(crate) fn is_empty(&self) -> bool {
        self.places.is_empty()
    }
}

/// Whether the input of a connection is extrapolated: a fault, an array or a sampled output has no derivatives.
fn is_extrapolated(components: &[LoadedComponent], connection: &ResolvedConnection) -> bool {
    let ResolvedConnection { from, to, faults, .. } = connection;
    let is_scalar = |id: &ScalarId| {
        let variable = id.variable(components);
        id.access_type(components) == Type::Float64
            && variable.dimensions.is_empty()
            && variable.variability == Variability::Continuous
    };
    components[to.component].inputs == Inputs::Extrapolated
        && from.fmu(components).output_derivatives > 0
        && !components[from.component].sampled
        && faults.is_empty()
        && is_scalar(from)
        && is_scalar(to)
}

impl ExtrapolatedInput {
    /// The derivative of an order at a time (s), of which 0 is the value: the polynomial of Taylor.
    pub(crate) fn derivative(&self, order: usize, time: f64, store: &Store) -> f64 {
        let elapsed = time - store.reals[self.time];
        let all = [self.from].into_iter().chain(self.derivatives.clone());
        let (mut term, mut sum) = (1.0, 0.0);
        for (power, place) in all.skip(order).enumerate() {
            if power > 0 {
                term *= elapsed / power as f64;
            }
            sum += term * store.reals[place];
        }
        sum
    }
}
