//! A temporary Slurm on this machine: daemons of the calling user, in a separate folder. No accounting, no cgroups,
//! no keys; two fake GPUs per node. The names of its nodes are not the machine's.

use std::fs::File;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// The programs that are needed.
const PROGRAMS: [&str; 7] = ["slurmctld", "slurmd", "sbatch", "squeue", "scancel", "scontrol", "sinfo"];

/// The time limit for the start of the daemons.
const PATIENCE: Duration = Duration::from_secs(20);

pub(crate) struct Slurm {
    dir: TempDir,
    controller: Child,
    nodes: Vec<Child>,
}

impl Slurm {
    /// Starts the daemons; reports the test as skipped where they are not installed or cannot run.
    pub(crate) fn start() -> Option<Self> {
        Self::with(1, "REQUEUE")
    }

    /// Like [`Self::start`], with this number of nodes, and with this fate of jobs that others preempt.
    pub(crate) fn with(nodes: usize, preempt_mode: &str) -> Option<Self> {
        let is_installed = |program: &&str| {
            let path = std::env::var("PATH").unwrap_or_default() + ":/usr/sbin:/sbin";
            path.split(':').any(|folder| Path::new(folder).join(program).is_file())
        };
        if let Some(missing) = PROGRAMS.iter().find(|program| !is_installed(program)) {
            support::skip(&format!("{missing} is not installed (Debian: slurm-wlm)"));
            return None;
        }
        let dir = tempfile::Builder::new().prefix("slurm-").tempdir().expect("a folder for Slurm");
        configure(dir.path(), nodes, preempt_mode);
        let controller = start_controller(dir.path());
        let nodes = (1..=nodes).map(|number| start_node(dir.path(), &format!("node{number}"))).collect();
        let slurm = Self { dir, controller, nodes };
        let clock = Instant::now();
        let are_idle = |states: String| !states.is_empty() && states.lines().all(|state| state == "idle");
        while !are_idle(output(slurm.command("sinfo").args(["-h", "-N", "-o", "%T"]))) {
            if clock.elapsed() > PATIENCE {
                support::skip(&format!("Slurm does not come up: {}", slurm.logs()));
                return None;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        Some(slurm)
    }

    /// The variable by which commands find this Slurm.
    pub(crate) fn variable(&self) -> (&'static str, PathBuf) {
        ("SLURM_CONF", self.dir.path().join("slurm.conf"))
    }

    pub(crate) fn command(&self, program: &str) -> Command {
        command(self.dir.path(), program)
    }

    /// The output of a command of Slurm.
    pub(crate) fn ask(&self, program: &str, arguments: &[&str]) -> String {
        output(self.command(program).args(arguments))
    }

    /// Kills the controller without warning, and starts it again.
    pub(crate) fn restart_controller(&mut self) {
        self.controller.kill().expect("the controller is killed");
        self.controller.wait().expect("the controller has ended");
        std::thread::sleep(Duration::from_secs(1));
        self.controller = start_controller(self.dir.path());
    }

    /// Resumes drained nodes and releases held jobs, as an administrator would. Slurm drains a node where a requeued job
    /// starts before the node has forgotten its killed predecessor ("Duplicate jobid").
    pub(crate) fn resume_nodes(&self) {
        if self.ask("sinfo", &["-h", "-o", "%T"]).contains("drain") {
            for number in 1..=self.nodes.len() {
                self.ask("scontrol", &["update", &format!("nodename=node{number}"), "state=resume"]);
            }
            let jobs = self.ask("squeue", &["-h", "-r", "-o", "%i %r"]);
            for held in jobs.lines().filter(|job| job.contains("held")) {
                self.ask("scontrol", &["release", held.split(' ').next().unwrap_or_default()]);
            }
        }
    }

    /// The ids of the running elements, e.g. `12_3`.
    pub(crate) fn running(&self) -> Vec<String> {
        self.ask("squeue", &["-h", "-r", "-t", "RUNNING", "-o", "%i"]).lines().map(str::to_owned).collect()
    }

    /// The last lines of the daemons' logs.
    pub(crate) fn logs(&self) -> String {
        let read = |name: &str| std::fs::read_to_string(self.dir.path().join(name)).unwrap_or_default();
        let text = read("ctld.log") + &read("d-node1.log");
        let lines: Vec<&str> = text.lines().filter(|line| line.contains("error")).collect();
        lines[lines.len().saturating_sub(8)..].join("; ")
    }
}

impl Drop for Slurm {
    fn drop(&mut self) {
        let _ = self.command("scancel").args(["--full", "--me"]).output();
        let clock = Instant::now();
        while !self.running().is_empty() && clock.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(200));
        }
        for daemon in self.nodes.iter_mut().chain([&mut self.controller]) {
            // Fails only if the daemon has ended.
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
    }
}

fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("an address").port()
}

fn configure(dir: &Path, nodes: usize, preempt_mode: &str) {
    let host = output(Command::new("hostname").arg("-s")).trim().to_owned();
    let controller_port = free_port();
    let (root, user) = (dir.display(), output(Command::new("id").arg("-un")).trim().to_owned());
    let cpus = std::thread::available_parallelism().map_or(1, usize::from);
    let text = format!(
        "ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/none
CredType=cred/none
AuthInfo=cred_expire=5
SlurmctldPort={controller_port}
SlurmctldPidFile={root}/ctld.pid
SlurmdPidFile={root}/d-%n.pid
StateSaveLocation={root}/ctld
SlurmdSpoolDir={root}/d-%n
SlurmctldLogFile={root}/ctld.log
SlurmdLogFile={root}/d-%n.log
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SwitchType=switch/none
SchedulerType=sched/backfill
SchedulerParameters=bf_interval=1,sched_min_interval=0,batch_sched_delay=0,sched_interval=1
DependencyParameters=kill_invalid_depend
SlurmctldParameters=preempt_send_user_signal
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
DefMemPerCPU=100
PreemptType=preempt/partition_prio
PreemptMode={preempt_mode}
JobRequeue=1
ReturnToService=2
KillWait=5
MinJobAge=600
MaxArraySize=1001
SlurmctldTimeout=30
SlurmdTimeout=60
GresTypes=gpu
PartitionName=batch Nodes=ALL Default=YES MaxTime=60 PriorityTier=1 PreemptMode={preempt_mode} GraceTime=10
PartitionName=urgent Nodes=ALL Default=NO MaxTime=60 PriorityTier=10 PreemptMode=OFF
"
    );
    let names: Vec<String> = (1..=nodes).map(|number| format!("node{number}")).collect();
    let node = |name: &String| {
        let port = free_port();
        format!(
            "NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs={cpus} RealMemory=1500 Gres=gpu:2\n"
        )
    };
    let text = text + &names.iter().map(node).collect::<String>();
    std::fs::write(dir.join("slurm.conf"), text).expect("the configuration is written");
    let gres = "Name=gpu File=/dev/null,/dev/zero\n";
    std::fs::write(dir.join("gres.conf"), gres).expect("the configuration is written");
    let of_nodes = names.iter().map(|name| format!("d-{name}"));
    for folder in of_nodes.chain(["ctld".into()]) {
        std::fs::create_dir(dir.join(folder)).expect("a folder for the daemon");
    }
}

fn command(dir: &Path, program: &str) -> Command {
    let mut command = Command::new(program);
    command.env("SLURM_CONF", dir.join("slurm.conf")).stdin(Stdio::null());
    command.env("PATH", std::env::var("PATH").unwrap_or_default() + ":/usr/sbin:/sbin");
    command
}

fn start_controller(dir: &Path) -> Child {
    start(command(dir, "slurmctld").arg("-D"), dir, "ctld.out")
}

fn start_node(dir: &Path, name: &str) -> Child {
    start(command(dir, "slurmd").args(["-D", "-N", name]), dir, "d.out")
}

fn start(command: &mut Command, dir: &Path, log: &str) -> Child {
    use std::os::unix::process::CommandExt;
    let log = File::options().create(true).append(true).open(dir.join(log)).expect("a log");
    command.process_group(0).stdout(log.try_clone().expect("a log")).stderr(log);
    command.spawn().expect("the daemon starts")
}

fn output(command: &mut Command) -> String {
    let Output { stdout, .. } = command.output().expect("the command starts");
    String::from_utf8_lossy(&stdout).into_owned()
}
