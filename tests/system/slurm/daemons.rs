//! A throw-away Slurm on this machine: two daemons under the calling user, in a folder of their own. No accounting, no
//! cgroups, no keys; two fake GPUs.

use std::fs::File;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// The programs that are needed.
const PROGRAMS: [&str; 7] = ["slurmctld", "slurmd", "sbatch", "squeue", "scancel", "scontrol", "sinfo"];

/// The time in which the daemons come up.
const PATIENCE: Duration = Duration::from_secs(20);

pub(crate) struct Slurm {
    dir: TempDir,
    controller: Child,
    node: Child,
    host: String,
}

impl Slurm {
    /// Starts the daemons; reports the test as skipped where they are not installed or cannot run.
    pub(crate) fn start() -> Option<Self> {
        let is_installed = |program: &&str| {
            let path = std::env::var("PATH").unwrap_or_default() + ":/usr/sbin:/sbin";
            path.split(':').any(|folder| Path::new(folder).join(program).is_file())
        };
        if let Some(missing) = PROGRAMS.iter().find(|program| !is_installed(program)) {
            support::skip(&format!("{missing} is not installed (Debian: slurm-wlm)"));
            return None;
        }
        let dir = tempfile::Builder::new().prefix("slurm-").tempdir().expect("a folder for Slurm");
        let host = output(Command::new("hostname").arg("-s")).trim().to_owned();
        configure(dir.path(), &host);
        let [controller, node] = [start_controller(dir.path()), start_node(dir.path(), &host)];
        let slurm = Self { dir, controller, node, host };
        let clock = Instant::now();
        while output(slurm.command("sinfo").args(["-h", "-o", "%T"])).lines().next() != Some("idle") {
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

    /// What a command of Slurm prints.
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

    /// The ids of the running elements, e.g. `12_3`.
    pub(crate) fn running(&self) -> Vec<String> {
        self.ask("squeue", &["-h", "-r", "-t", "RUNNING", "-o", "%i"]).lines().map(str::to_owned).collect()
    }

    /// The last lines of the daemons' logs.
    pub(crate) fn logs(&self) -> String {
        let read = |name: &str| std::fs::read_to_string(self.dir.path().join(name)).unwrap_or_default();
        let text = read("ctld.log") + &read("d.log");
        let lines: Vec<&str> = text.lines().filter(|line| line.contains("error")).collect();
        lines[lines.len().saturating_sub(8)..].join("; ")
    }
}

impl Drop for Slurm {
    fn drop(&mut self) {
        let _ = self.command("scancel").args(["--full", "--nodelist", &self.host]).output();
        let clock = Instant::now();
        while !self.running().is_empty() && clock.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(200));
        }
        for daemon in [&mut self.node, &mut self.controller] {
            // Fails only if the daemon has ended.
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
    }
}

fn configure(dir: &Path, host: &str) {
    let [controller_port, node_port] = [0; 2].map(|_| {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        listener.local_addr().expect("an address").port()
    });
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
SlurmdPort={node_port}
SlurmctldPidFile={root}/ctld.pid
SlurmdPidFile={root}/d.pid
StateSaveLocation={root}/ctld
SlurmdSpoolDir={root}/d
SlurmctldLogFile={root}/ctld.log
SlurmdLogFile={root}/d.log
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
PreemptMode=REQUEUE
JobRequeue=1
ReturnToService=2
KillWait=5
MinJobAge=600
MaxArraySize=1001
SlurmctldTimeout=30
SlurmdTimeout=60
GresTypes=gpu
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory=1500 Gres=gpu:2 State=UNKNOWN
PartitionName=batch Nodes={host} Default=YES MaxTime=60 PriorityTier=1 PreemptMode=REQUEUE GraceTime=10
PartitionName=urgent Nodes={host} Default=NO MaxTime=60 PriorityTier=10 PreemptMode=OFF
"
    );
    std::fs::write(dir.join("slurm.conf"), text).expect("the configuration is written");
    let gres = format!("NodeName={host} Name=gpu File=/dev/null,/dev/zero\n");
    std::fs::write(dir.join("gres.conf"), gres).expect("the configuration is written");
    for folder in ["ctld", "d"] {
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

fn start_node(dir: &Path, host: &str) -> Child {
    start(command(dir, "slurmd").args(["-D", "-N", host]), dir, "d.out")
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
