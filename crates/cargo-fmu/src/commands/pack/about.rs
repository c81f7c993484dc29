//! What the page of a container says of the system: a diagram, its components and its connections.

use std::collections::BTreeMap;

use fmu_description::xml::escape;
use fmu_master::container::Contents;
use fmu_master::{Description, Order};

/// The size of a component in the diagram, and the distances between components.
const BOX: [usize; 2] = [150, 36];
const PITCH: [usize; 2] = [170, 64];

/// The middle of the page.
pub(super) fn html(description: &Description, contents: &Contents) -> String {
    let order = match description.order {
        Order::Sequential => "one after the other",
        Order::Parallel => "in parallel",
        Order::Implicit => "again and again until their outputs agree",
    };
    let rows = contents.components.iter().map(|(name, file, platforms)| {
        let platforms = Vec::from_iter(platforms.iter().map(String::as_str)).join(", ");
        let [name, file, platforms] = [name, file, &platforms].map(|text| escape(&**text));
        format!("<tr><td>{name}</td><td>{file}</td><td>{platforms}</td></tr>\n")
    });
    let connections = description.connections.iter().map(|connection| {
        let faults = if connection.faults.is_empty() { "" } else { ", with faults" };
        let [from, to] = [&connection.from, &connection.to].map(|name| escape(&**name));
        format!("<li><code>{from}</code> to <code>{to}</code>{faults}</li>\n")
    });
    format!(
        "<h2>System</h2>\n{}<p>The components step {order}, every {:?} s. A communication step of the host is this step \
        or a multiple.</p>\n<table>\n<thead><tr><th>component</th><th>FMU</th><th>platforms</th></tr></thead>\n<tbody>\n\
        {}</tbody>\n</table>\n<ul>\n{}<li>The system file is <code>resources/system.toml</code>.</li>\n</ul>\n",
        diagram(description),
        description.step,
        rows.collect::<String>(),
        connections.collect::<String>(),
    )
}

/// The components on a diagonal, in their order: connections to later ones are above it, and back to earlier ones below.
fn diagram(description: &Description) -> String {
    let names = description.components.iter().map(|component| component.name.as_str());
    let names = Vec::from_iter(names);
    let component = |variable: &str| {
        let found = names.iter().enumerate().filter(|(_, name)| {
            variable.strip_prefix(*name).is_some_and(|rest| rest.starts_with('.'))
        });
        found.max_by_key(|(_, name)| name.len()).map(|(index, name)| (index, name.len() + 1))
    };
    let mut signals: BTreeMap<(usize, usize), Vec<&str>> = BTreeMap::new();
    for connection in &description.connections {
        if let (Some((from, prefix)), Some((to, _))) =
            (component(&connection.from), component(&connection.to))
        {
            let name = &connection.from[prefix..];
            let names = signals.entry((from, to)).or_default();
            if !names.contains(&name) {
                names.push(name);
            }
        }
    }
    let [width, height] = [0, 1].map(|i| names.len().saturating_sub(1) * PITCH[i] + BOX[i] + 40);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-20 -20 {width} {height}\" width=\"{width}\" role=\"img\" \
        aria-label=\"Components and connections\" font-size=\"13\" fill=\"none\" stroke=\"currentColor\">\n\
        <defs><marker id=\"arrow\" markerWidth=\"8\" markerHeight=\"8\" refX=\"7\" refY=\"4\" orient=\"auto\">\
        <path d=\"M0,0 L8,4 L0,8 z\" fill=\"currentColor\" stroke=\"none\"/></marker></defs>\n"
    );
    let label = |x: usize, y: usize, anchor: &str, text: &str| {
        format!(
            "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\" fill=\"currentColor\" stroke=\"none\">{}</text>\n",
            escape(text)
        )
    };
    for ((from, to), names) in &signals {
        let middle = from * PITCH[1] + BOX[1] / 2;
        let end = to * PITCH[0] + BOX[0] / 2;
        let text = match names.as_slice() {
            [name] => (*name).to_owned(),
            names => format!("{} signals", names.len()),
        };
        let (begin, tip, at) = match from < to {
            true => (from * PITCH[0] + BOX[0], to * PITCH[1], end - 6),
            false => (from * PITCH[0], to * PITCH[1] + BOX[1], end + 6),
        };
        let anchor = if from < to { "end" } else { "start" };
        svg += &format!(
            "<path d=\"M{begin},{middle} H{end} V{tip}\" marker-end=\"url(#arrow)\"/>\n{}",
            label(at, middle - 4, anchor, &text)
        );
    }
    for (index, name) in names.iter().enumerate() {
        let [x, y] = [index * PITCH[0], index * PITCH[1]];
        let [width, height] = BOX;
        svg += &format!(
            "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" rx=\"4\"/>\n{}",
            label(x + width / 2, y + height / 2 + 5, "middle", name)
        );
    }
    svg + "</svg>\n"
}
