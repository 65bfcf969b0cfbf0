//! The registry: all stages of the binary, with their types erased.

mod params;
#[cfg(test)]
pub(crate) mod tests;

use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::path::Path;

use anyhow::Context as _;
use serde_json::Value;

use crate::canonical;
use crate::fingerprint::{Code, CodeTable, UnusedSources, stage_code};
use crate::library::Builtins;
use crate::{Artifact, Facts, JobContext, ParamProblem, PlanContext, Port, Resolution, Resources, Source, Stage, Work};

/// Number of digits that distinguish two builds.
const SHORT_DIGEST: usize = 12;

/// All stages by id, and the built-in recipes, e.g. `Registry::new(CODE).with::<Training>()`.
pub struct Registry {
    code: CodeTable,
    built_with: &'static str,
    recipes: Builtins,
    stages: BTreeMap<&'static str, Box<dyn AnyStage>>,
}

/// A [`Stage`] whose parameters are JSON.
///
/// Parameters that a method takes as `&Value` are canonical: they come from [`AnyStage::canonical_params`].
pub trait AnyStage: Send + Sync {
    /// [`Stage::ID`].
    fn id(&self) -> &'static str;
    /// [`Stage::ABOUT`].
    fn about(&self) -> &'static str;
    /// [`Stage::ON_DEVICE`].
    fn on_device(&self) -> bool;
    /// [`Stage::ports`].
    fn ports(&self) -> Vec<Port>;
    /// Name and schema version of the artifact type that the stage makes.
    fn output(&self) -> (&'static str, u32);
    /// The default parameters, whether or not they are complete enough to run.
    fn default_params(&self) -> Value;
    /// The parameters as the stage's type serializes them, with all defaults; or all problems.
    fn canonical_params(&self, raw: &Value) -> Result<Value, Vec<ParamProblem>>;
    /// [`Stage::sources`].
    fn sources(&self, params: &Value) -> anyhow::Result<Vec<Source>>;
    /// [`Stage::facts`].
    fn facts(&self, params: &Value, context: &PlanContext<'_>) -> anyhow::Result<Facts>;
    /// [`Stage::resolve`], with canonical parameters in and out.
    fn resolve(&self, params: &Value, context: &PlanContext<'_>) -> Result<Resolution<Value>, Vec<ParamProblem>>;
    /// [`Stage::work`].
    fn work(&self, params: &Value, context: &PlanContext<'_>) -> anyhow::Result<Option<Work>>;
    /// [`Stage::resources`].
    fn resources(&self, params: &Value) -> anyhow::Result<Resources>;
    /// [`Stage::unused_sources`].
    fn unused_sources(&self, params: &Value) -> anyhow::Result<UnusedSources>;
    /// [`Stage::values`].
    fn values(&self, key: &str) -> Option<Vec<String>>;
    /// Opens and checks an artifact of the stage.
    fn open(&self, dir: &Path) -> anyhow::Result<()>;
    /// Runs the stage and checks the artifact that it returns, then opens the output folder and checks the artifact
    /// that it reads.
    fn run(&self, context: &JobContext, params: &Value) -> anyhow::Result<()>;
}

impl Registry {
    /// A registry without stages. `code` lists the sources that the binary was built from.
    pub fn new(code: CodeTable) -> Self {
        Self { code, built_with: "unknown", recipes: &[], stages: BTreeMap::new() }
    }

    /// Sets the compiler that built the program, e.g. `rustc 1.95.0`. Never part of a key.
    pub fn compiled_by(mut self, compiler: &'static str) -> Self {
        self.built_with = compiler;
        self
    }

    /// Adds the recipes that are built into the program. Recipes extend them as `builtin:NAME`.
    pub fn with_recipes(mut self, recipes: Builtins) -> Self {
        self.recipes = recipes;
        self
    }

    /// The recipes that are built into the program.
    pub fn recipes(&self) -> Builtins {
        self.recipes
    }

    /// The compiler that built the program.
    pub fn built_with(&self) -> &'static str {
        self.built_with
    }

    /// The first digits of a SHA-256 over all sources that the program was built from.
    pub fn sources_digest(&self) -> String {
        let crates = self.code.crates.iter().map(|code| (code.name, code.files, code.external));
        let digest = canonical::sha256_hex("pipeline/sources/1", &serde_json::json!(crates.collect::<Vec<_>>()));
        digest[..SHORT_DIGEST].to_owned()
    }

    /// Adds a stage.
    ///
    /// # Panics
    ///
    /// If the id is taken, or if the code table has no crate of that name.
    pub fn with<S: Stage>(mut self) -> Self {
        assert!(self.code.get(S::ID).is_some(), "no crate in the code table is named like the stage {}", S::ID);
        let taken = self.stages.insert(S::ID, Box::new(Erased::<S>(PhantomData)));
        assert!(taken.is_none(), "two stages are called {}", S::ID);
        self
    }

    /// The stage called `id`.
    pub fn get(&self, id: &str) -> Option<&dyn AnyStage> {
        self.stages.get(id).map(Box::as_ref)
    }

    /// All stages, ordered by id.
    pub fn stages(&self) -> impl Iterator<Item = &dyn AnyStage> {
        self.stages.values().map(Box::as_ref)
    }

    /// The fingerprint of the code that can influence a result of the stage `id`, without the `unused` sources.
    pub fn code(&self, id: &str, unused: &UnusedSources) -> Code {
        stage_code(&self.code, id, unused)
    }
}

struct Erased<S>(PhantomData<fn() -> S>);

impl<S: Stage> AnyStage for Erased<S> {
    fn id(&self) -> &'static str {
        S::ID
    }

    fn about(&self) -> &'static str {
        S::ABOUT
    }

    fn on_device(&self) -> bool {
        S::ON_DEVICE
    }

    fn ports(&self) -> Vec<Port> {
        S::ports()
    }

    fn output(&self) -> (&'static str, u32) {
        (S::Output::NAME, S::Output::SCHEMA)
    }

    fn default_params(&self) -> Value {
        serde_json::to_value(S::Params::default()).expect("parameters are JSON")
    }

    fn canonical_params(&self, raw: &Value) -> Result<Value, Vec<ParamProblem>> {
        params::canonical::<S>(raw)
    }

    fn sources(&self, params: &Value) -> anyhow::Result<Vec<Source>> {
        Ok(S::sources(&typed::<S>(params)?))
    }

    fn facts(&self, params: &Value, context: &PlanContext<'_>) -> anyhow::Result<Facts> {
        Ok(S::facts(&typed::<S>(params)?, context))
    }

    fn resolve(&self, params: &Value, context: &PlanContext<'_>) -> Result<Resolution<Value>, Vec<ParamProblem>> {
        let params = typed::<S>(params).map_err(|error| vec![params::problem("", format!("{error:#}"))])?;
        S::resolve(params, context)?.map(|params| params::written_back(&params).map_err(|problem| vec![problem]))
    }

    fn work(&self, params: &Value, context: &PlanContext<'_>) -> anyhow::Result<Option<Work>> {
        Ok(S::work(&typed::<S>(params)?, context))
    }

    fn resources(&self, params: &Value) -> anyhow::Result<Resources> {
        Ok(S::resources(&typed::<S>(params)?))
    }

    fn unused_sources(&self, params: &Value) -> anyhow::Result<UnusedSources> {
        Ok(S::unused_sources(&typed::<S>(params)?))
    }

    fn values(&self, key: &str) -> Option<Vec<String>> {
        S::values(key)
    }

    fn open(&self, dir: &Path) -> anyhow::Result<()> {
        let read = S::Output::open(dir)
            .with_context(|| format!("cannot read back the {} that {} wrote", S::Output::NAME, S::ID))?;
        read.check()
            .with_context(|| format!("the {} that {} wrote is not valid when read back", S::Output::NAME, S::ID))
    }

    fn run(&self, context: &JobContext, params: &Value) -> anyhow::Result<()> {
        let artifact = S::run(context, &typed::<S>(params)?)?;
        artifact.check().with_context(|| format!("{} returned a {} that is not valid", S::ID, S::Output::NAME))?;
        drop(artifact);
        self.open(context.output_dir())
    }
}

/// Converts canonical parameters into the stage's type.
fn typed<S: Stage>(params: &Value) -> anyhow::Result<S::Params> {
    serde_json::from_value(params.clone()).with_context(|| format!("invalid parameters of {}", S::ID))
}
