//! Connections and recorded variables, grouped by component and type for reading and writing.

use std::collections::BTreeMap;

use fmu_description::VariableType;

use crate::Scale;
use crate::system::{Link, Planned, Port};
use crate::transfer::Group;

/// The inputs of one component and type, and the outputs that feed them, in the same order.
pub(crate) struct Wire {
    pub(crate) kind: VariableType,
    pub(crate) outputs: Vec<Group>,
    pub(crate) inputs: Group,
    /// The inputs whose values are scaled, by position.
    pub(crate) scales: Vec<(usize, Scale)>,
}

/// Variables of one component and type that are recorded, and their columns.
pub(crate) struct Record {
    pub(crate) kind: VariableType,
    pub(crate) group: Group,
    pub(crate) columns: Vec<usize>,
}

const CHANNELS: [VariableType; 3] = [
    VariableType::Real,
    VariableType::Integer,
    VariableType::Boolean,
];

/// Groups the connections by the component that they feed, the type, and the component they come from.
pub(crate) fn wires(components: &[Planned], links: &[Link]) -> Vec<Vec<Wire>> {
    let of_component = |fed: usize| {
        let of_kind = |kind: VariableType| {
            let mut groups: BTreeMap<usize, (Group, Group, Vec<Option<Scale>>)> = BTreeMap::new();
            for link in links.iter().filter(|link| {
                link.to.component == fed && link.to.of(components).kind.accessed_as() == kind
            }) {
                let (outputs, inputs, scales) = groups.entry(link.from.component).or_default();
                push(outputs, components, link.from);
                push(inputs, components, link.to);
                scales.push(link.scale);
            }
            let mut all = Group {
                component: fed,
                ..Group::default()
            };
            let (mut outputs, mut scales) = (Vec::new(), Vec::new());
            for (group, inputs, of_group) in groups.into_values() {
                let positions = all.references.len()..;
                let scaled = positions.zip(of_group);
                scales.extend(scaled.filter_map(|(position, scale)| Some((position, scale?))));
                outputs.push(group);
                all.references.extend(inputs.references);
                all.names.extend(inputs.names);
            }
            (!outputs.is_empty()).then_some(Wire {
                kind,
                outputs,
                inputs: all,
                scales,
            })
        };
        CHANNELS.into_iter().filter_map(of_kind).collect()
    };
    (0..components.len()).map(of_component).collect()
}

/// Groups the recorded variables by component and type.
pub(crate) fn records(components: &[Planned], ports: &[Port]) -> Vec<Record> {
    let mut records = Vec::new();
    for component in 0..components.len() {
        for kind in CHANNELS {
            let mut record = Record {
                kind,
                group: Group::default(),
                columns: Vec::new(),
            };
            for (column, port) in ports.iter().enumerate() {
                if port.component == component && port.of(components).kind.accessed_as() == kind {
                    push(&mut record.group, components, *port);
                    record.columns.push(column);
                }
            }
            if !record.columns.is_empty() {
                records.push(record);
            }
        }
    }
    records
}

fn push(group: &mut Group, components: &[Planned], port: Port) {
    let variable = port.of(components);
    group.component = port.component;
    group.references.push(variable.reference);
    group.names.push(variable.name.clone());
}
