//! Terminals of networks and the manifest of FMI-LS-BUS, from the fields of a struct.
#![allow(dead_code, reason = "only the tables are under test")]

use fmu_description::Interface;
use fmu_description::interface::{size, write};
use fmu_export::prelude::*;

use super::{assert_is_file, description};

/// A gateway between networks
#[derive(Model)]
#[model(clocked, bus_simulation)]
struct Gateway {
    #[nested]
    powertrain: Node,
    #[nested]
    body: [Port; 2],
    /// set-point
    #[input(terminal = "loop.r")]
    r: f64,
}

/// A node of a network.
#[derive(Variables)]
struct Node {
    #[nested(flatten)]
    port: Port,
    /// whether the bus confirms frames
    #[parameter(network = "Configuration.BusNotifications")]
    notifications: bool,
}

/// A port of a network.
#[derive(Variables)]
struct Port {
    /// operations from the bus
    #[input(clocks(rx_clock), network = "Rx_Data", mime_type = "application/x", max_size = 99)]
    rx_data: Vec<u8>,
    /// operations to the bus
    #[output(clocks(tx_clock), network = "Tx_Data", mime_type = "application/x", max_size = 99)]
    tx_data: Vec<u8>,
    /// ticks with operations from the bus
    #[input(network = "Rx_Clock")]
    rx_clock: Clock,
    /// ticks with operations to the bus
    #[input(countdown, network = "Tx_Clock")]
    tx_clock: Clock,
}

impl Clocked for Gateway {
    fn tick(&mut self, _time: f64) -> Result<(), ModelError> {
        Ok(())
    }
}

const GATEWAY: Interface =
    fmu_export::interface::<Gateway, { <Gateway as Variables>::COUNT }>(None);
static GATEWAY_COPY: [u8; size(&GATEWAY)] = write(&GATEWAY);

#[test]
fn a_port_is_the_terminal_of_a_network_named_as_its_field() {
    let terminals = description(&GATEWAY_COPY).terminals(false).unwrap().unwrap();
    assert_is_file("Gateway_terminals.xml", &terminals.document().unwrap());
}

#[test]
fn only_a_model_with_a_network_has_the_manifest() {
    let gateway = description(&GATEWAY_COPY);
    let manifest = gateway.bus_manifest().unwrap();
    assert_is_file("Gateway_manifest.xml", &manifest.document().unwrap());
    assert_eq!(description(&super::TANK_COPY).bus_manifest(), None);
}

#[test]
fn a_network_lacks_no_member_and_has_none_twice() {
    let mut gateway = description(&GATEWAY_COPY);
    let tx_clock = gateway.variables.iter().position(|v| v.name == "body[2].tx_clock").unwrap();
    let removed = gateway.variables.remove(tx_clock);
    let error = gateway.terminals(false).unwrap_err().to_string();
    assert!(
        error.starts_with("0 variables of Gateway are the member Tx_Clock of the network body[2]")
    );
    gateway.variables.extend([removed.clone(), removed]);
    let error = gateway.terminals(false).unwrap_err().to_string();
    assert!(
        error.starts_with("2 variables of Gateway are the member Tx_Clock of the network body[2]")
    );
}
