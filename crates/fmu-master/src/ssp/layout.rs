//! The layout of a system's diagram: positions of components and routes of connections.
//!
//! Signals flow from left to right: a component is placed in the column after those that feed it. A
//! connection to the next column runs between the two; one that skips columns runs above all
//! components, one that leads back runs below them. No line crosses a component.

/// Width of a component and of the gap between two columns.
const WIDTH: f64 = 40.0;
const GAP: f64 = 40.0;
/// Height per connector, and distance between components of a column.
const PITCH: f64 = 5.0;
const SPACING: f64 = 20.0;
/// Distance between two lines above or below all components.
const LANE: f64 = 4.0;

/// A component in the diagram.
pub struct Part {
    /// Number of connectors on the left.
    pub inputs: usize,
    /// Number of connectors on the right.
    pub outputs: usize,
}

/// A connector on the left or right of a component.
#[derive(Clone, Copy)]
pub struct Pin {
    /// Index of the component.
    pub part: usize,
    /// Index among the connectors of its side, from the top.
    pub index: usize,
}

/// A connection, from an output to an input.
#[derive(Clone, Copy)]
pub struct Link {
    /// The output.
    pub from: Pin,
    /// The input.
    pub to: Pin,
}

/// A rectangle; y points up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Area {
    /// Left, bottom, right, top.
    pub x1: f64,
    pub y1: f64,
    pub x2: f64,
    pub y2: f64,
}

/// A diagram.
pub struct Layout {
    /// The area of each component.
    pub parts: Vec<Area>,
    /// The points of each connection between its two ends.
    pub lines: Vec<Vec<(f64, f64)>>,
    /// The bounding box.
    pub extent: Area,
}

/// The height of a connector: 0 at the bottom of its component, 1 at the top.
pub fn height(index: usize, count: usize) -> f64 {
    1.0 - (index as f64 + 0.5) / count as f64
}

/// Lays out a diagram.
pub fn lay_out(parts: &[Part], links: &[Link]) -> Layout {
    let columns = columns(parts.len(), links);
    let areas = place(parts, &columns);
    let bottom = areas.iter().map(|area| area.y1).fold(0.0, f64::min);
    let count = links.len() as f64;
    let lines = links.iter().enumerate().map(|(index, link)| {
        let (from, to) = (areas[link.from.part], areas[link.to.part]);
        let start = level(from, link.from.index, parts[link.from.part].outputs);
        let end = level(to, link.to.index, parts[link.to.part].inputs);
        // Each line has its own position in the gaps, above and below.
        let place = GAP * (index as f64 + 1.0) / (count + 1.0);
        let lane = LANE * (index as f64 + 1.0);
        let (leave, enter) = (from.x2 + place, to.x1 - GAP + place);
        let (column, fed) = (columns[link.from.part], columns[link.to.part]);
        let around = |y| vec![(leave, start), (leave, y), (enter, y), (enter, end)];
        if fed == column + 1 {
            vec![(leave, start), (leave, end)]
        } else if fed > column {
            around(lane)
        } else {
            around(bottom - lane)
        }
    });
    let lines: Vec<_> = lines.collect();
    let room = LANE * (count + 1.0);
    let right = areas.iter().map(|area| area.x2).fold(0.0, f64::max);
    Layout {
        extent: Area {
            x1: -GAP,
            y1: bottom - room,
            x2: right + GAP,
            y2: room,
        },
        parts: areas,
        lines,
    }
}

fn level(area: Area, index: usize, count: usize) -> f64 {
    area.y1 + (area.y2 - area.y1) * height(index, count)
}

/// The column of each component: one after the last component that feeds it, ignoring feedback.
fn columns(count: usize, links: &[Link]) -> Vec<usize> {
    let is_fed = |part: usize| links.iter().any(|link| link.to.part == part);
    let mut order = Vec::new();
    let (fed, sources): (Vec<_>, Vec<_>) = (0..count).partition(|part| is_fed(*part));
    for part in sources.into_iter().chain(fed) {
        visit(part, links, &mut vec![false; count], &mut order);
    }
    order.reverse(); // each component before those that it feeds
    let mut columns = vec![0; count];
    for (position, &part) in order.iter().enumerate() {
        for link in links.iter().filter(|link| link.from.part == part) {
            let fed = link.to.part;
            if order[position + 1..].contains(&fed) {
                columns[fed] = columns[fed].max(columns[part] + 1);
            }
        }
    }
    columns
}

/// Appends a component to the order, after those that it feeds.
fn visit(part: usize, links: &[Link], open: &mut Vec<bool>, order: &mut Vec<usize>) {
    if open[part] || order.contains(&part) {
        return;
    }
    open[part] = true;
    for link in links.iter().filter(|link| link.from.part == part) {
        visit(link.to.part, links, open, order);
    }
    order.push(part);
}

/// Stacks the components of each column, the first on top.
fn place(parts: &[Part], columns: &[usize]) -> Vec<Area> {
    let mut tops = vec![0.0; parts.len()];
    let place = |(part, &column): (&Part, &usize)| {
        let x1 = column as f64 * (WIDTH + GAP);
        let y2: f64 = tops[column];
        let y1 = y2 - PITCH * (part.inputs.max(part.outputs).max(2) + 1) as f64;
        tops[column] = y1 - SPACING;
        Area {
            x1,
            y1,
            x2: x1 + WIDTH,
            y2,
        }
    };
    parts.iter().zip(columns).map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn link(from: usize, to: usize) -> Link {
        let pin = |part| Pin { part, index: 0 };
        Link {
            from: pin(from),
            to: pin(to),
        }
    }

    #[test]
    fn signals_flow_from_left_to_right() {
        // controller, plant, source, with feedback from the plant to the controller
        assert_eq!(columns(3, &[link(2, 0), link(1, 0), link(0, 1)]), [1, 2, 0]);
        // supervisor, its plant, controller, plant, source
        let supervised = [(4, 0), (1, 0), (0, 1), (4, 2), (3, 2), (0, 2), (2, 3)];
        let supervised = supervised.map(|(from, to)| link(from, to));
        assert_eq!(columns(5, &supervised), [1, 2, 2, 3, 0]);
        // A loop without a source.
        assert_eq!(columns(2, &[link(0, 1), link(1, 0)]), [0, 1]);
    }
}
