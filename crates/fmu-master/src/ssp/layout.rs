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

/// A rectangle: left, bottom, right, top; y points up.
pub type Area = [f64; 4];
/// A connector: the index of its component, and its index on a side of the component, from the top.
pub type Pin = (usize, usize);

/// A diagram.
pub struct Layout {
    /// The area of each component.
    pub areas: Vec<Area>,
    /// The points of each connection between its two ends.
    pub lines: Vec<Vec<(f64, f64)>>,
}

/// The height of a connector: 0 at the bottom of its component, 1 at the top.
pub fn height(index: usize, count: usize) -> f64 {
    1.0 - (index as f64 + 0.5) / count as f64
}

/// Lays out a diagram of components with these numbers of inputs, on the left, and of outputs, on the right;
/// each link leads from an output to an input.
pub fn lay_out(sizes: &[[usize; 2]], links: &[[Pin; 2]]) -> Layout {
    let feeds = Vec::from_iter(links.iter().map(|[from, to]| (from.0, to.0)));
    let columns = columns(sizes.len(), &feeds);
    let areas = place(sizes, &columns);
    let bottom = areas.iter().map(|area| area[1]).fold(0.0, f64::min);
    let count = links.len() as f64;
    let level = |(part, index): Pin, side: usize| {
        let [_, bottom, _, top] = areas[part];
        bottom + (top - bottom) * height(index, sizes[part][side])
    };
    let line = |(number, &[from, to]): (usize, &[Pin; 2])| {
        let (start, end) = (level(from, 1), level(to, 0));
        // Each line has its own position in the gaps, above and below.
        let place = GAP * (number as f64 + 1.0) / (count + 1.0);
        let lane = LANE * (number as f64 + 1.0);
        let (leave, enter) = (areas[from.0][2] + place, areas[to.0][0] - GAP + place);
        let around = |y| vec![(leave, start), (leave, y), (enter, y), (enter, end)];
        let (column, fed) = (columns[from.0], columns[to.0]);
        if fed == column + 1 {
            vec![(leave, start), (leave, end)]
        } else if fed > column {
            around(lane)
        } else {
            around(bottom - lane)
        }
    };
    Layout { lines: links.iter().enumerate().map(line).collect(), areas }
}

/// The column of each component: one after the last component that feeds it, ignoring feedback. `feeds` are
/// the components at both ends of each connection.
fn columns(count: usize, feeds: &[(usize, usize)]) -> Vec<usize> {
    let is_fed = |part: usize| feeds.iter().any(|(_, to)| *to == part);
    let (fed, sources): (Vec<_>, Vec<_>) = (0..count).partition(|part| is_fed(*part));
    let mut order = Vec::new();
    for part in sources.into_iter().chain(fed) {
        visit(part, feeds, &mut vec![false; count], &mut order);
    }
    order.reverse(); // each component before those that it feeds
    let mut columns = vec![0; count];
    for (position, &part) in order.iter().enumerate() {
        for &(_, fed) in feeds.iter().filter(|(from, _)| *from == part) {
            if order[position + 1..].contains(&fed) {
                columns[fed] = columns[fed].max(columns[part] + 1);
            }
        }
    }
    columns
}

/// Appends a component to the order, after those that it feeds.
fn visit(part: usize, feeds: &[(usize, usize)], open: &mut [bool], order: &mut Vec<usize>) {
    if open[part] || order.contains(&part) {
        return;
    }
    open[part] = true;
    for &(_, fed) in feeds.iter().filter(|(from, _)| *from == part) {
        visit(fed, feeds, open, order);
    }
    order.push(part);
}

/// Stacks the components of each column, the first on top.
fn place(sizes: &[[usize; 2]], columns: &[usize]) -> Vec<Area> {
    let mut tops = vec![0.0; sizes.len()];
    let place = |(&[inputs, outputs], &column): (&[usize; 2], &usize)| {
        let left = column as f64 * (WIDTH + GAP);
        let top: f64 = tops[column];
        let bottom = top - PITCH * (inputs.max(outputs).max(2) + 1) as f64;
        tops[column] = bottom - SPACING;
        [left, bottom, left + WIDTH, top]
    };
    sizes.iter().zip(columns).map(place).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_flow_from_left_to_right() {
        // controller, plant, source, with feedback from the plant to the controller
        assert_eq!(columns(3, &[(2, 0), (1, 0), (0, 1)]), [1, 2, 0]);
        // supervisor, its plant, controller, plant, source
        let supervised = [(4, 0), (1, 0), (0, 1), (4, 2), (3, 2), (0, 2), (2, 3)];
        assert_eq!(columns(5, &supervised), [1, 2, 2, 3, 0]);
        // A loop without a source.
        assert_eq!(columns(2, &[(0, 1), (1, 0)]), [0, 1]);
    }
}
