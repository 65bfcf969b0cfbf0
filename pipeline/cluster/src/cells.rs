//! Cells: the parts of a plan that become batch jobs. A cell is a training with the jobs that only this training feeds
//! or needs. Jobs that several cells need form preparing cells; jobs that collect the results of several cells, e.g.
//! reports, run at the end.

use std::collections::{BTreeMap, BTreeSet};

use engine::{DeviceClass, Node, Plan};
use serde::{Deserialize, Serialize};

/// A part of a plan that one batch job computes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// The name of its training or, without one, of its last job.
    pub name: String,
    /// Indices of its jobs in the plan.
    pub nodes: BTreeSet<usize>,
    /// The cells whose results it reads.
    pub producers: BTreeSet<usize>,
    /// What its batch job needs.
    pub class: Class,
}

/// A class of batch jobs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Class {
    /// Jobs that several trainings need.
    Prepare,
    /// Trainings on the processor.
    Cpu,
    /// Trainings on a GPU.
    Gpu,
    /// The jobs that collect results.
    Report,
}

/// The cells of a plan, and the collecting jobs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cells {
    /// The cells.
    pub cells: Vec<Cell>,
    /// Indices of the jobs that collect the results of several cells.
    pub collecting: BTreeSet<usize>,
}

impl Cells {
    /// Divides `nodes` of a plan, which have to run; `is_training` distinguishes trainings from other jobs.
    pub fn of(plan: &Plan, nodes: &BTreeSet<usize>, is_training: impl Fn(&Node) -> bool) -> Self {
        let is_cell = cell_makers(plan, is_training);
        let owners = owners(plan, &is_cell);
        let collecting: BTreeSet<usize> = nodes.iter().copied().filter(|&at| owners[at] == Owner::Many).collect();
        let keys = keys(plan, &owners);
        let mut cells: Vec<Cell> = Vec::new();
        let mut cell_of_key: BTreeMap<usize, usize> = BTreeMap::new();
        for &index in nodes.difference(&collecting) {
            let key = keys[index];
            let at = *cell_of_key.entry(key).or_insert_with(|| {
                let class = class(plan, key, is_cell[key]);
                cells.push(Cell {
                    name: plan.nodes[key].name.clone(),
                    nodes: BTreeSet::new(),
                    producers: BTreeSet::new(),
                    class,
                });
                cells.len() - 1
            });
            cells[at].nodes.insert(index);
        }
        for (own, cell) in cells.iter_mut().enumerate() {
            let read = cell.nodes.iter().flat_map(|&index| plan.nodes[index].producers());
            let of_cells = read.filter(|at| nodes.contains(at)).filter_map(|at| cell_of_key.get(&keys[at]).copied());
            cell.producers = of_cells.filter(|&other| other != own).collect();
        }
        Self { cells, collecting }
    }
}

/// The training that a job depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Owner {
    /// None: the job prepares.
    Unowned,
    /// The job is this training, or needs no other.
    One(usize),
    /// Several: the job collects.
    Many,
}

/// The jobs that define a cell: trainings, except those that serve only one other training.
fn cell_makers(plan: &Plan, is_training: impl Fn(&Node) -> bool) -> Vec<bool> {
    let mut consumers = vec![Vec::new(); plan.nodes.len()];
    for (index, node) in plan.nodes.iter().enumerate() {
        node.producers().into_iter().for_each(|producer| consumers[producer].push(index));
    }
    let serves_one = |index: usize| matches!(consumers[index][..], [only] if is_training(&plan.nodes[only]));
    let nodes = plan.nodes.iter().enumerate();
    nodes.map(|(index, node)| is_training(node) && !serves_one(index)).collect()
}

fn owners(plan: &Plan, is_cell: &[bool]) -> Vec<Owner> {
    let mut owners: Vec<Owner> = Vec::with_capacity(plan.nodes.len());
    for (index, node) in plan.nodes.iter().enumerate() {
        let found: Vec<Owner> = node.producers().into_iter().map(|producer| owners[producer]).collect();
        let trainings: BTreeSet<usize> =
            found.iter().filter_map(|owner| if let Owner::One(at) = owner { Some(*at) } else { None }).collect();
        let collects = node.inputs.iter().any(|input| input.many) || found.contains(&Owner::Many);
        owners.push(match (is_cell[index], trainings.first()) {
            (true, _) => Owner::One(index),
            (_, None) if !collects => Owner::Unowned,
            (_, Some(only)) if !collects && trainings.len() == 1 => Owner::One(*only),
            _ => Owner::Many,
        });
    }
    owners
}

/// For each job, the representative of its cell: the training, or the last job of a preparing cell.
fn keys(plan: &Plan, owners: &[Owner]) -> Vec<usize> {
    let count = plan.nodes.len();
    // The trainings that need a preparing job; consumers have larger indices.
    let mut users: Vec<BTreeSet<usize>> = vec![BTreeSet::new(); count];
    for index in (0..count).rev() {
        let own = match owners[index] {
            Owner::One(training) => BTreeSet::from([training]),
            Owner::Unowned => users[index].clone(),
            Owner::Many => continue,
        };
        plan.nodes[index].producers().into_iter().for_each(|producer| users[producer].extend(&own));
    }
    let only_user = |index: usize| if users[index].len() == 1 { users[index].first().copied() } else { None };
    let is_shared = |index: usize| owners[index] == Owner::Unowned && only_user(index).is_none();
    let mut keys: Vec<usize> = (0..count).collect();
    for index in (0..count).rev() {
        keys[index] = match owners[index] {
            Owner::One(training) => training,
            _ => only_user(index).unwrap_or(keys[index]),
        };
        if is_shared(index) {
            let key = keys[index];
            for producer in plan.nodes[index].producers().into_iter().filter(|&producer| is_shared(producer)) {
                let joined = keys[producer];
                // Two chains that meet in one producer become one.
                keys.iter_mut().filter(|of| **of == joined).for_each(|of| *of = key);
            }
        }
    }
    keys
}

fn class(plan: &Plan, key: usize, is_training: bool) -> Class {
    match (is_training, plan.device_of(&plan.nodes[key])) {
        (false, _) => Class::Prepare,
        (true, DeviceClass::Cpu) => Class::Cpu,
        (true, DeviceClass::Gpu) => Class::Gpu,
    }
}

#[cfg(test)]
#[path = "cells_tests.rs"]
pub(crate) mod tests;
