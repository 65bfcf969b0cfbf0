//! The cluster file: the site's options for batch jobs. Never part of a key.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use engine::{Failure, FailureKind};
use fs_err as fs;
use serde::{Deserialize, Serialize};

use crate::cells::Class;

/// A cluster file. Every key is optional.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClusterFile {
    /// Options of every batch job, e.g. `["--constraint=a100"]`.
    pub extra: Vec<String>,
    /// Shell lines before the program, e.g. `["module load vulkan"]`.
    pub prologue: Vec<String>,
    /// The account that is charged.
    pub account: Option<String>,
    /// The quality of service.
    pub qos: Option<String>,
    /// The partition.
    pub partition: Option<String>,
    /// The largest number of elements of one array that run at the same time.
    pub throttle: usize,
    /// How often a cell that ends without a result is submitted, including the first time.
    pub attempts: usize,
    /// The time before the end of an allocation at which trainings save their progress and the job is put back into the
    /// queue; by default three times the longest measured time of saving a checkpoint, and some slack.
    #[serde(with = "humantime_text_option")]
    pub signal_lead: Option<Duration>,
    /// The interval at which the batch system is polled.
    #[serde(with = "humantime_text")]
    pub poll: Duration,
    /// The time after which jobs that the batch system no longer knows count as lost.
    #[serde(with = "humantime_text")]
    pub patience: Duration,
    /// Additional requirements of the jobs of a class: `prepare`, `cpu`, `gpu`, `report`.
    pub class: BTreeMap<Class, ClassOptions>,
}

/// The requirements of the batch jobs of one class.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClassOptions {
    /// The partition, instead of that of the file.
    pub partition: Option<String>,
    /// The account, instead of that of the file.
    pub account: Option<String>,
    /// The quality of service, instead of that of the file.
    pub qos: Option<String>,
    /// The time limit, e.g. `2h`; by default three times the predicted time, if there is a prediction.
    #[serde(with = "humantime_text_option")]
    pub time: Option<Duration>,
    /// The number of processors per job.
    pub cpus: Option<usize>,
    /// The memory per job as Slurm writes it, e.g. `16G`; by default 1.5 times the largest measured memory, if there is
    /// one.
    pub memory: Option<String>,
    /// Generic resources, e.g. `gpu:1`.
    pub gres: Option<String>,
    /// Further options.
    pub extra: Vec<String>,
}

impl Default for ClusterFile {
    fn default() -> Self {
        Self {
            extra: Vec::new(),
            prologue: Vec::new(),
            account: None,
            qos: None,
            partition: None,
            throttle: 64,
            attempts: 3,
            signal_lead: None,
            poll: Duration::from_secs(15),
            patience: Duration::from_secs(300),
            class: BTreeMap::new(),
        }
    }
}

impl ClusterFile {
    /// Reads a cluster file. An error names the file and what is wrong.
    pub fn read(path: &Path) -> anyhow::Result<Self> {
        let failure = |message: String| Failure::new(FailureKind::BadInput, message).at(path);
        let text =
            fs::read_to_string(path).map_err(|error| failure(format!("cannot read the cluster file ({error})")))?;
        let file: Self = toml::from_str(&text).map_err(|error| failure(format!("invalid cluster file: {error}")))?;
        if file.attempts == 0 || file.throttle == 0 {
            return Err(failure("attempts and throttle must be at least 1".into()).into());
        }
        Ok(file)
    }

    /// The options of a class. `prepare` and `report` fall back to `cpu`.
    pub fn class(&self, class: Class) -> ClassOptions {
        let found = self.class.get(&class).or_else(|| match class {
            Class::Prepare | Class::Report => self.class.get(&Class::Cpu),
            _ => None,
        });
        let own = found.cloned().unwrap_or_default();
        ClassOptions {
            partition: own.partition.or_else(|| self.partition.clone()),
            account: own.account.or_else(|| self.account.clone()),
            qos: own.qos.or_else(|| self.qos.clone()),
            extra: self.extra.iter().chain(&own.extra).cloned().collect(),
            gres: own.gres.or_else(|| (class == Class::Gpu).then(|| "gpu:1".into())),
            ..own
        }
    }
}

/// Durations as text, e.g. `2h`.
mod humantime_text {
    use std::time::Duration;

    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub(super) fn serialize<S: Serializer>(time: &Duration, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&humantime::format_duration(*time).to_string())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Duration, D::Error> {
        humantime::parse_duration(&String::deserialize(from)?).map_err(D::Error::custom)
    }
}

/// Optional durations as text.
mod humantime_text_option {
    use std::time::Duration;

    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub(super) fn serialize<S: Serializer>(time: &Option<Duration>, to: S) -> Result<S::Ok, S::Error> {
        match time {
            Some(time) => super::humantime_text::serialize(time, to),
            None => to.serialize_none(),
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Duration>, D::Error> {
        let text = Option::<String>::deserialize(from)?;
        text.map(|text| humantime::parse_duration(&text).map_err(D::Error::custom)).transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = r#"
account = "vision"
throttle = 8
prologue = ["module load vulkan"]
[class.cpu]
partition = "long"
time = "2h"
memory = "8G"
[class.gpu]
partition = "gpu"
gres = "gpu:a100:1"
extra = ["--constraint=nvlink"]
"#;

    #[test]
    fn classes_inherit_from_the_file() {
        let file: ClusterFile = toml::from_str(FILE).unwrap();
        let gpu = file.class(Class::Gpu);
        assert_eq!((gpu.partition.as_deref(), gpu.account.as_deref()), (Some("gpu"), Some("vision")));
        assert_eq!((gpu.gres.as_deref(), gpu.time), (Some("gpu:a100:1"), None));
        let report = file.class(Class::Report);
        assert_eq!((report.partition.as_deref(), report.gres), (Some("long"), None));
        assert_eq!(report.time, Some(Duration::from_secs(7200)));
        assert_eq!(ClusterFile::default().class(Class::Gpu).gres.as_deref(), Some("gpu:1"));
    }

    #[test]
    fn batch_jobs_read_what_the_submission_wrote() {
        for file in [ClusterFile::default(), toml::from_str(FILE).unwrap()] {
            let written = serde_json::to_string(&file).unwrap();
            let read: ClusterFile = serde_json::from_str(&written).unwrap();
            assert_eq!(serde_json::to_string(&read).unwrap(), written);
        }
    }

    #[test]
    fn errors_name_the_line_and_the_key() {
        let wrong = FILE.replace("memory =", "memroy =");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site.toml");
        std::fs::write(&path, wrong).unwrap();
        let message = ClusterFile::read(&path).unwrap_err().to_string();
        assert!(message.contains("line 8") && message.contains("memroy"), "{message}");
    }
}
