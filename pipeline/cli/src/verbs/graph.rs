//! `graph`: prints the job graph, coloured by state.

use std::path::Path;

use engine::graph::{dot, mermaid};

use crate::args::{GraphArgs, GraphFormat};
use crate::error::CliError;
use crate::output::print;
use crate::session::Session;

pub(crate) fn graph(store: &Path, args: &GraphArgs) -> Result<u8, CliError> {
    let session = Session::read_only(store, &args.recipe)?;
    let states = session.predict()?.into_iter().map(|(index, prediction)| (index, prediction.node_state())).collect();
    print(&match args.format {
        GraphFormat::Dot => dot(&session.plan, &states, args.collapse),
        GraphFormat::Mermaid => mermaid(&session.plan, &states, args.collapse),
    })?;
    Ok(engine::exit::OK)
}
