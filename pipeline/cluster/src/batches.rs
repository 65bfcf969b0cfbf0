//! Batches: the job arrays that a set of cells becomes, with the dependencies that the batch system keeps.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::cells::{Cell, Class};

/// A job array. Each element computes one cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Batch {
    /// The class of all elements.
    pub class: Class,
    /// Element number → index of the cell.
    pub elements: BTreeMap<u32, usize>,
    /// The batches that must succeed before.
    pub after: After,
}

/// The dependency of a batch on earlier ones.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum After {
    /// None.
    Nothing,
    /// Each element on the element of the same number in an earlier batch (`aftercorr`).
    Corresponding(usize),
    /// All elements on these elements (batch, number) of earlier batches (`afterok`).
    Elements(Vec<(usize, u32)>),
}

/// Puts the cells with these indices into batches of at most `max_size` elements. A cell depends only on the cells that it
/// reads, never on a whole stage. Cells that are not in `wanted` are finished.
pub(crate) fn batches(cells: &[Cell], wanted: &BTreeSet<usize>, max_size: usize) -> Vec<Batch> {
    let mut batches: Vec<Batch> = Vec::new();
    let mut place: BTreeMap<usize, (usize, u32)> = BTreeMap::new();
    for level in levels(cells, wanted) {
        let mut groups: BTreeMap<(Class, Vec<usize>), Vec<usize>> = BTreeMap::new();
        for cell in level {
            let producers = cells[cell].producers.intersection(wanted).copied().collect();
            groups.entry((cells[cell].class, producers)).or_default().push(cell);
        }
        for (class, rows) in corresponding(&groups, &place) {
            for (batch, elements) in rows {
                push(&mut batches, &mut place, Batch { class, elements, after: After::Corresponding(batch) });
            }
            groups.retain(|(other, producers), _| *other != class || producers.len() != 1);
        }
        for ((class, producers), group) in groups {
            for part in group.chunks(max_size.max(1)) {
                let after = match producers[..] {
                    [] => After::Nothing,
                    _ => After::Elements(producers.iter().map(|producer| place[producer]).collect()),
                };
                let elements = (0..).zip(part.iter().copied()).collect();
                push(&mut batches, &mut place, Batch { class, elements, after });
            }
        }
    }
    batches
}

fn push(batches: &mut Vec<Batch>, place: &mut BTreeMap<usize, (usize, u32)>, batch: Batch) {
    let at = batches.len();
    place.extend(batch.elements.iter().map(|(number, cell)| (*cell, (at, *number))));
    batches.push(batch);
}

/// The wanted cells by the length of the longest chain of cells before them.
fn levels(cells: &[Cell], wanted: &BTreeSet<usize>) -> Vec<Vec<usize>> {
    let mut depth: BTreeMap<usize, usize> = wanted.iter().map(|cell| (*cell, 0)).collect();
    // Chains are short, so a few rounds find all depths.
    let mut is_settled = false;
    while !is_settled {
        is_settled = true;
        for cell in wanted {
            let before = cells[*cell].producers.iter().filter_map(|producer| depth.get(producer)).max();
            let own = before.map_or(0, |depth| depth + 1);
            is_settled &= depth.insert(*cell, own) == Some(own);
        }
    }
    let mut levels: Vec<Vec<usize>> = Vec::new();
    for (cell, own) in depth {
        levels.resize(levels.len().max(own + 1), Vec::new());
        levels[own].push(cell);
    }
    levels
}

/// Element number → cell.
type Elements = BTreeMap<u32, usize>;

/// Element-wise dependencies of the classes whose cells read one cell each: for each class, the batches that it depends
/// on, each with the elements that correspond to the elements of that batch. Classes for which this needs no fewer
/// arrays than one array per producer are left out.
fn corresponding(
    groups: &BTreeMap<(Class, Vec<usize>), Vec<usize>>,
    place: &BTreeMap<usize, (usize, u32)>,
) -> Vec<(Class, Vec<(usize, Elements)>)> {
    let classes: BTreeSet<Class> = groups.keys().map(|(class, _)| *class).collect();
    let rows = |class: Class| {
        let mut rows: BTreeMap<(usize, usize), Elements> = BTreeMap::new();
        let mut producers = 0;
        for ((_, producer), group) in groups.iter().filter(|((other, read), _)| *other == class && read.len() == 1) {
            producers += 1;
            let (batch, number) = place[&producer[0]];
            for (rank, cell) in group.iter().enumerate() {
                rows.entry((batch, rank)).or_default().insert(number, *cell);
            }
        }
        let rows: Vec<(usize, Elements)> = rows.into_iter().map(|((batch, _), elements)| (batch, elements)).collect();
        (!rows.is_empty() && rows.len() < producers).then_some((class, rows))
    };
    classes.into_iter().filter_map(rows).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(class: Class, producers: &[usize]) -> Cell {
        Cell { name: String::new(), nodes: BTreeSet::new(), producers: producers.iter().copied().collect(), class }
    }

    fn all(cells: &[Cell]) -> BTreeSet<usize> {
        (0..cells.len()).collect()
    }

    #[test]
    fn trainings_wait_for_their_own_scene_only() {
        let mut cells = vec![cell(Class::Prepare, &[]), cell(Class::Prepare, &[])];
        cells.extend([0, 0, 0, 1, 1, 1].map(|scene| cell(Class::Gpu, &[scene])));
        let batches = batches(&cells, &all(&cells), 1000);
        assert_eq!(batches.len(), 3, "{batches:?}");
        assert_eq!(batches[1].after, After::Elements(vec![(0, 0)]));
        assert_eq!(batches[2].after, After::Elements(vec![(0, 1)]));
        assert_eq!(batches[2].elements, BTreeMap::from([(0, 5), (1, 6), (2, 7)]));
    }

    #[test]
    fn chains_of_trainings_depend_element_by_element() {
        let mut cells: Vec<Cell> = (0..4).map(|_| cell(Class::Cpu, &[])).collect();
        cells.extend((0..4).map(|coarse| cell(Class::Cpu, &[coarse])));
        let batches = batches(&cells, &all(&cells), 1000);
        assert_eq!(batches.len(), 2);
        assert_eq!(batches[1].after, After::Corresponding(0));
        assert_eq!(batches[1].elements[&3], 7);
        // A finished producer is not a dependency.
        let rest = super::batches(&cells, &BTreeSet::from([0, 4, 5]), 1000);
        assert_eq!(rest[0].elements, BTreeMap::from([(0, 0), (1, 5)]));
        assert_eq!(rest[1].after, After::Elements(vec![(0, 0)]));
    }

    #[test]
    fn long_arrays_are_split() {
        let cells: Vec<Cell> = (0..25).map(|_| cell(Class::Cpu, &[])).collect();
        let sizes: Vec<usize> = batches(&cells, &all(&cells), 10).iter().map(|batch| batch.elements.len()).collect();
        assert_eq!(sizes, [10, 10, 5]);
    }
}
