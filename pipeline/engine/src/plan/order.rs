//! The order in which a run launches jobs: depth first.

use super::Plan;

impl Plan {
    /// The rank of each node. The jobs of one cell of a table (capture, training, renders, metrics) come together, so that
    /// an interrupted run leaves complete cells. A job comes after its producers, and a job that collects the results of
    /// many cells comes last.
    pub fn depth_first_ranks(&self) -> Vec<usize> {
        let mut ranks = vec![None; self.nodes.len()];
        let mut next = 0;
        let mut is_read = vec![false; self.nodes.len()];
        for node in &self.nodes {
            for input in node.inputs.iter().filter(|input| !input.many) {
                input.producers.iter().for_each(|&producer| is_read[producer] = true);
            }
        }
        // The last job of a cell is read only by collecting jobs, which are themselves last jobs.
        for last in (0..self.nodes.len()).filter(|&index| !is_read[index]) {
            self.rank(last, &mut ranks, &mut next);
        }
        ranks.into_iter().map(|rank| rank.expect("every node leads to one that no job for one reads")).collect()
    }

    /// Ranks the producers of a node, then the node itself.
    fn rank(&self, index: usize, ranks: &mut [Option<usize>], next: &mut usize) {
        if ranks[index].is_some() {
            return;
        }
        self.nodes[index].producers().into_iter().for_each(|producer| self.rank(producer, ranks, next));
        ranks[index] = Some(*next);
        *next += 1;
    }
}

#[cfg(test)]
mod tests {
    use crate::recipe::tests::plan;

    #[test]
    fn the_jobs_of_a_cell_come_together() {
        let recipe = r#"
[axes]
scene = ["x", "y"]
method = ["a", "b"]
[nodes.report]
stage = "test-list"
inputs = { texts = ["metrics", "train", "capture"] }
[nodes.capture]
stage = "test-write"
over = ["scene"]
[nodes.train]
stage = "test-work"
over = ["scene", "method"]
inputs = { text = "capture" }
[nodes.metrics]
stage = "test-work"
over = ["scene", "method"]
inputs = { text = "train" }
"#;
        let plan = plan(recipe, &[]);
        let ranks = plan.depth_first_ranks();
        let mut order: Vec<usize> = (0..plan.nodes.len()).collect();
        order.sort_by_key(|&index| ranks[index]);
        let names: Vec<&str> = order.iter().map(|&index| plan.nodes[index].name.as_str()).collect();
        insta::assert_snapshot!(names.join("\n"), @r"
        capture/x
        train/x/a
        metrics/x/a
        train/x/b
        metrics/x/b
        capture/y
        train/y/a
        metrics/y/a
        train/y/b
        metrics/y/b
        report
        ");
    }
}
