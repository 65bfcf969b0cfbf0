//! Checks that the templates of a recipe fit together: stages, ports, types, arity, no cycles.

use crate::registry::AnyStage;
use crate::suggest::{names_hint, nearest};
use crate::{Arity, Port, Registry};

use super::errors::{Report, join_arrows};
use super::raw::{Like, Named, RawRecipe, Template, Wire};

/// Checks all templates. Returns their indices, producers first (ties in the order of the file), unless there is a
/// cycle.
pub(super) fn check(recipe: &RawRecipe, registry: &Registry, report: &mut Report) -> Option<Vec<usize>> {
    for (name, template) in &recipe.templates {
        let key = format!("nodes.{name}");
        match registry.get(&template.stage.name) {
            Some(stage) => Checker { recipe, registry, name, template, stage }.check(report),
            None => {
                let stages = names_hint(&template.stage.name, registry.stages().map(|stage| stage.id()));
                let (message, hint) = match template.stage.name.as_str() {
                    "" => (format!("node `{name}` has no stage"), similar_node(recipe, name).unwrap_or(stages)),
                    stage => (format!("unknown stage `{stage}`"), stages),
                };
                report.add(&template.stage.at, format!("{key}.stage"), message, Some(hint));
            }
        }
    }
    order(recipe).map_err(|cycle| report_cycle(recipe, &cycle, report)).ok()
}

/// Refuses axes that no node runs over, e.g. misspelt ones. Those of a base recipe are kept: a recipe that extends it cannot
/// remove them.
pub(super) fn refuse_unused_axes(recipe: &RawRecipe, report: &mut Report) {
    let is_used = |index: usize| recipe.templates.values().any(|template| template.over.contains(&index));
    let (used, unused): (Vec<usize>, Vec<usize>) = (0..recipe.axes.len()).partition(|index| is_used(*index));
    for (name, axis) in unused.into_iter().filter_map(|index| recipe.axes.get_index(index)) {
        if report.texts.is_in_base(&axis.at) {
            continue;
        }
        let advice = format!("add \"{name}\" to the `over` of a node, or remove the axis");
        let hint = match nearest(name, used.iter().map(|&index| recipe.axis_name(index))) {
            Some(similar) => format!("did you mean `{similar}`? Otherwise {advice}"),
            None => advice,
        };
        report.add(&axis.at, format!("axes.{name}"), format!("no node runs over the axis `{name}`"), Some(hint));
    }
}

/// The hint for a node without a stage whose name resembles that of a complete node.
fn similar_node(recipe: &RawRecipe, name: &str) -> Option<String> {
    let complete = recipe.templates.iter().filter(|(_, template)| !template.stage.name.is_empty());
    let similar = nearest(name, complete.map(|(name, _)| name.as_str()))?;
    Some(format!("did you mean `{similar}`? Otherwise set nodes.{name}.stage"))
}

/// One template with its stage.
struct Checker<'a> {
    recipe: &'a RawRecipe,
    registry: &'a Registry,
    name: &'a str,
    template: &'a Template,
    stage: &'a dyn AnyStage,
}

impl Checker<'_> {
    fn check(&self, report: &mut Report) {
        self.check_like(report);
        let ports = self.stage.ports();
        for wire in &self.template.inputs {
            match ports.iter().find(|port| port.name == wire.port.name) {
                Some(port) => self.check_wire(port, wire, report),
                None => {
                    let message = format!("stage `{}` has no port `{}`", self.stage.id(), wire.port.name);
                    let hint = Some(names_hint(&wire.port.name, ports.iter().map(|port| port.name)));
                    report.add(&wire.port.at, self.key(&wire.port.name), message, hint);
                }
            }
        }
        let wired = |port: &Port| self.template.inputs.iter().any(|wire| wire.port.name == port.name);
        for port in ports.iter().filter(|port| port.arity == Arity::One && !wired(port)) {
            let message = format!("stage `{}` needs an input on port `{}`", self.stage.id(), port.name);
            let makers = self.makers(port);
            let hint = match makers.is_empty() {
                true => format!("no node of this recipe produces a {}", port.artifact.0),
                false => format!("nodes that produce a {}: {}", port.artifact.0, makers.join(", ")),
            };
            report.add(&self.template.at, self.key(port.name), message, Some(hint));
        }
    }

    /// `like` must name a node of the same stage and determine one job of it.
    fn check_like(&self, report: &mut Report) {
        let Some(Like { node, values }) = &self.template.like else { return };
        let key = format!("nodes.{}.like", self.name);
        let Some(model) = self.recipe.templates.get(&node.name) else {
            let hint = Some(names_hint(&node.name, self.recipe.templates.keys().map(String::as_str)));
            return report.add(&node.at, key, format!("unknown node `{}`", node.name), hint);
        };
        let is_known =
            |axis: &&usize| self.template.over.contains(axis) || values.iter().any(|(fixed, _)| fixed == *axis);
        let open = model.over.iter().find(|axis| !is_known(axis)).map(|&axis| self.recipe.axis_name(axis));
        if model.stage.name != self.template.stage.name {
            let message = format!("node `{}` is of stage `{}`", node.name, model.stage.name);
            report.add(&node.at, key, message, Some("`like` takes nodes of the same stage".into()));
        } else if model.like.is_some() || node.name == self.name {
            report.add(&node.at, key, format!("node `{}` itself uses `like`", node.name), None);
        } else if let Some(axis) = open {
            let (own, other) = (self.name, &node.name);
            let message = format!("node `{own}` is `like` one job of `{other}`, but there is one for each {axis}");
            let like = format!("nodes.{own}.like = {{ node = \"{other}\", {axis} = … }}");
            report.add(&node.at, key, message, Some(format!("add \"{axis}\" to nodes.{own}.over, or write {like}")));
        }
    }

    fn check_wire(&self, port: &Port, wire: &Wire, report: &mut Report) {
        let key = self.key(port.name);
        let (fits, wanted) = match port.arity {
            Arity::One => (wire.from.len() == 1, "one producer"),
            // An empty array removes the wiring of a base recipe.
            Arity::Optional => (wire.from.len() <= 1, "at most one producer"),
            Arity::Choice | Arity::Many => (true, "any number"),
        };
        if !fits {
            let message = format!("port `{}` takes {wanted}, not {}", port.name, wire.from.len());
            report.add(&wire.port.at, &key, message, None);
        }
        for (index, from) in wire.from.iter().enumerate() {
            if wire.from[..index].iter().any(|known| known.name == from.name) {
                report.add(&from.at, &key, format!("node `{}` occurs twice", from.name), None);
            }
            match self.recipe.templates.get(&from.name) {
                Some(producer) => self.check_producer(port, from, producer, report),
                None => {
                    let hint = Some(names_hint(&from.name, self.recipe.templates.keys().map(String::as_str)));
                    report.add(&from.at, &key, format!("unknown node `{}`", from.name), hint);
                }
            }
        }
    }

    fn check_producer(&self, port: &Port, from: &Named, producer: &Template, report: &mut Report) {
        let key = self.key(port.name);
        if let Some(stage) = self.registry.get(&producer.stage.name)
            && stage.output() != port.artifact
        {
            let ((made, made_schema), (read, read_schema)) = (stage.output(), port.artifact);
            let message = format!(
                "port `{}` reads {read} (schema {read_schema}), but node `{}` makes {made} (schema {made_schema})",
                port.name, from.name
            );
            let makers = self.makers(port);
            let hint = (!makers.is_empty()).then(|| format!("nodes that produce a {read}: {}", makers.join(", ")));
            report.add(&from.at, &key, message, hint);
        }
        let lacking: Vec<&str> = producer
            .over
            .iter()
            .filter(|axis| !self.template.over.contains(axis))
            .map(|&axis| self.recipe.axis_name(axis))
            .collect();
        if port.arity != Arity::Many && !lacking.is_empty() {
            let message = format!(
                "port `{}` takes one producer, but there is one `{}` for each {}",
                port.name,
                from.name,
                lacking.join(" and ")
            );
            let hint = format!("add {} to nodes.{}.over", lacking.join(", "), self.name);
            report.add(&from.at, &key, message, Some(hint));
        }
    }

    /// The nodes that produce an artifact of the port's type.
    fn makers(&self, port: &Port) -> Vec<&str> {
        let fits = |template: &Template| {
            self.registry.get(&template.stage.name).is_some_and(|stage| stage.output() == port.artifact)
        };
        self.recipe.templates.iter().filter(|(_, template)| fits(template)).map(|(name, _)| name.as_str()).collect()
    }

    fn key(&self, port: &str) -> String {
        format!("nodes.{}.inputs.{port}", self.name)
    }
}

/// The templates that a template reads, by index.
fn producers(recipe: &RawRecipe, template: usize) -> impl Iterator<Item = usize> {
    let wires = recipe.templates[template].inputs.iter().flat_map(|wire| &wire.from);
    wires.filter_map(|from| recipe.templates.get_index_of(&from.name))
}

/// The templates with producers first, otherwise in the order of the file; or the indices along a cycle.
fn order(recipe: &RawRecipe) -> Result<Vec<usize>, Vec<usize>> {
    let mut order = Vec::new();
    while order.len() < recipe.templates.len() {
        let open = |index: &usize| !order.contains(index);
        let ready = |index: &usize| open(index) && producers(recipe, *index).all(|producer| !open(&producer));
        match (0..recipe.templates.len()).find(ready) {
            Some(next) => order.push(next),
            None => {
                // Every open template reads an open one, so following the producers ends in a cycle.
                let mut path: Vec<usize> = (0..recipe.templates.len()).find(open).into_iter().collect();
                loop {
                    let next =
                        producers(recipe, path[path.len() - 1]).find(open).expect("open templates read open ones");
                    if let Some(start) = path.iter().position(|&known| known == next) {
                        return Err(path[start..].to_vec());
                    }
                    path.push(next);
                }
            }
        }
    }
    Ok(order)
}

/// Reports a cycle at the first wire of it that the recipe itself has, or else at the first of a base recipe.
fn report_cycle(recipe: &RawRecipe, cycle: &[usize], report: &mut Report) {
    let name = |&index: &usize| recipe.templates.get_index(index).map_or(String::new(), |(name, _)| name.clone());
    // The path runs from consumer to producer, against the data; it is printed along the data.
    let names = cycle.iter().chain(cycle.first()).rev().map(name);
    let message = format!("nodes depend on each other: {}", join_arrows(names));
    let wires = cycle.iter().zip(cycle.iter().cycle().skip(1)).filter_map(|(consumer, producer)| {
        let from = recipe.templates[*consumer].inputs.iter().flat_map(|wire| &wire.from);
        Some((consumer, from.into_iter().find(|from| from.name == name(producer))?.at))
    });
    let place = wires.min_by_key(|(_, at)| report.texts.is_in_base(at));
    if let Some((consumer, at)) = place {
        report.add(&at, format!("nodes.{}.inputs", name(consumer)), message, None);
    }
}
