//! Cluster engines that train the runs of plans: what is submitted to them, and whether it is over. Engines place and
//! restart jobs and account for them; all information about runs stays in the runs' folders.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use protocol::digest;
use run::repeat::quoted;
use terminal::refusal::wrong_usage;

use crate::experiment::PlannedRun;
use crate::tasks::is_of_python;

/// Job script for Slurm; words between `@` are placeholders.
const SCRIPT: &str = include_str!("../cluster/experiment.sh");

/// Manifests for Kubernetes, with placeholders of the same form.
const MANIFESTS: &str = include_str!("../cluster/experiment.yaml");

/// Where pods mount the volume that has the folder of the runs at its root; also their working directory.
const VOLUME: &str = "/runs";

/// Cores that a run uses best when several runs train side by side.
const CORES_OF_A_RUN: usize = 2;

/// Memory of one run, GiB.
const MEMORY_OF_A_RUN_GIB: usize = 2;

/// Most tasks of a job if the user does not set their number.
const MOST_TASKS: usize = 64;

/// Flags of what a cluster does.
#[derive(Debug, clap::Args)]
pub(crate) struct ClusterArguments {
    /// Trains the missing runs on a cluster; the folder of the runs must be on a disk with file locks that all its
    /// machines share.
    #[arg(long, value_name = "ENGINE")]
    pub(crate) on: Option<Engine>,
    /// Tasks of the cluster's job; by default one for each run that is missing, at most 64.
    #[arg(long, requires = "on", value_parser = clap::value_parser!(u16).range(1..=1000))]
    tasks: Option<u16>,
    /// The image of Kubernetes' pods, see deploy/cluster/Dockerfile.
    #[arg(long, requires = "on", default_value = "goalward")]
    image: String,
    /// PersistentVolumeClaim of the volume that has the folder of the runs at its root.
    #[arg(long, requires = "on", default_value = "goalward-runs")]
    claim: String,
    /// Shows the progress of the runs until all are finished, wherever they train; Ctrl-C ends only this display.
    #[arg(long, conflicts_with = "dry_run")]
    pub(crate) watch: bool,
}

/// Who places what a cluster works on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Engine {
    /// A job array, submitted by `sbatch`, which reads SBATCH_PARTITION, SBATCH_ACCOUNT and SBATCH_TIMELIMIT.
    Slurm,
    /// A Job, submitted by `kubectl` in its current namespace.
    Kubernetes,
}

impl Engine {
    /// Checks that the cluster finds the user's own files that plans name when it trains their runs into `out`. Pods
    /// see only the volume; Slurm's jobs see what this machine sees.
    ///
    /// # Errors
    /// Wrong usage, for the first task or file of demonstrations that pods would not find.
    pub(crate) fn require_files(self, runs: &[PlannedRun], out: &Path) -> Result<()> {
        if self == Engine::Slurm {
            return Ok(());
        }
        let out = std::path::absolute(out).context("the folder of the runs")?;
        let volume = out.parent().unwrap_or(&out);
        for (what, file) in runs.iter().flat_map(own_files) {
            if !is_found_by_pods(file, volume) {
                return Err(wrong_usage(format!(
                    "{what} {}: expected a path relative to {volume}, where the command must run, \
                     since pods see only that folder; found one that pods cannot resolve",
                    file.display(),
                    volume = volume.display(),
                )));
            }
        }
        Ok(())
    }
}

/// Returns the user's own files that a plan names for a run, with their paths as in the plan.
fn own_files(run: &PlannedRun) -> impl Iterator<Item = (&'static str, &Path)> {
    let is_ours = run::tasks::names().any(|name| name == run.task);
    let task = (!is_ours && !is_of_python(&run.task)).then(|| Path::new(&run.task));
    let demonstrations = run.config.demonstrations.file.as_deref();
    let task = task.map(|file| ("task", file));
    task.into_iter().chain(demonstrations.map(|file| ("demonstrations", file)))
}

/// Returns whether a path leads to the same file in a pod as here, where `volume` is the pods' volume.
fn is_found_by_pods(file: &Path, volume: &Path) -> bool {
    let of_pods = Path::new(VOLUME).join(file);
    let Ok(inside) = of_pods.strip_prefix(VOLUME) else { return false };
    let there = volume.join(inside);
    let [here, there, volume] = [file, there.as_path(), volume].map(Path::canonicalize);
    let (Ok(here), Ok(there), Ok(volume)) = (here, there, volume) else { return false };
    // A link may lead out of the volume.
    here == there && here.starts_with(volume)
}

/// A job for an engine.
#[derive(Clone, Debug)]
pub(crate) struct Order {
    engine: Engine,
    /// Tasks of the job array, or pods.
    pub(crate) tasks: usize,
    /// Runs that each task trains at once.
    jobs: usize,
    plans: Vec<PathBuf>,
    /// Folder of the runs.
    out: PathBuf,
    /// Further flags of `goalward experiment`.
    flags: Vec<&'static str>,
    image: String,
    claim: String,
}

/// A submitted job.
#[derive(Clone, Debug)]
pub(crate) struct Submitted {
    engine: Engine,
    /// Name by which the engine knows the job.
    pub(crate) name: String,
    /// Whether it was not there before.
    pub(crate) is_new: bool,
}

impl ClusterArguments {
    /// Returns the job for `engine` if `missing` runs are left, with absolute paths of the plans and the folder of the
    /// runs.
    ///
    /// # Errors
    /// When a plan does not exist.
    pub(crate) fn order(
        &self,
        engine: Engine,
        missing: usize,
        jobs: usize,
        (plans, out): (&[PathBuf], &Path),
        flags: Vec<&'static str>,
    ) -> Result<Order> {
        let whole = |plan: &PathBuf| plan.canonicalize().context(plan.display().to_string());
        Ok(Order {
            engine,
            tasks: self.tasks.map_or(missing.min(MOST_TASKS), usize::from),
            jobs,
            plans: plans.iter().map(whole).collect::<Result<_>>()?,
            out: std::path::absolute(out).context("the folder of the runs")?,
            flags,
            image: self.image.clone(),
            claim: self.claim.clone(),
        })
    }
}

impl Order {
    /// Returns the job script or the manifests.
    ///
    /// # Errors
    /// When a plan cannot be read, or its name cannot be a key of a ConfigMap.
    pub(crate) fn text(&self) -> Result<String> {
        let tasks = self.tasks.to_string();
        let cores = (CORES_OF_A_RUN * self.jobs).to_string();
        match self.engine {
            Engine::Slurm => {
                let words = self.command(&own_path()?, self.plans.clone(), &self.out);
                let command = words.iter().map(quoted).collect::<Vec<_>>().join(" ");
                let values = [("TASKS", tasks), ("CORES", cores), ("COMMAND", command)];
                Ok(filled_in(SCRIPT, &values))
            }
            Engine::Kubernetes => {
                let names = self.plans.iter().map(|plan| file_name(plan));
                let names = names.collect::<Result<Vec<_>>>()?;
                let plans = names.iter().map(|name| Path::new("/plans").join(name)).collect();
                let out = Path::new(VOLUME).join(self.out.file_name().unwrap_or_default());
                let command = self.command(Path::new("goalward"), plans, &out);
                let texts = self.plans.iter().zip(&names).map(|(plan, name)| entry(plan, name));
                let values = [
                    ("PLANS", texts.collect::<Result<Vec<_>>>()?.join("\n")),
                    ("NAME", self.name()),
                    ("TASKS", tasks),
                    ("CORES", cores),
                    ("MEMORY", format!("{}Gi", MEMORY_OF_A_RUN_GIB * self.jobs)),
                    ("COMMAND", serde_json::to_string(&command)?),
                    ("IMAGE", self.image.clone()),
                    ("CLAIM", self.claim.clone()),
                ];
                Ok(filled_in(MANIFESTS, &values))
            }
        }
    }

    /// Submits the job to the engine. A Job of the same plans and folder that Kubernetes still has is left as it is.
    ///
    /// # Errors
    /// As [`Order::text`]; also when the engine's command is missing or fails.
    pub(crate) fn submit(&self) -> Result<Submitted> {
        let (engine, text) = (self.engine, self.text()?);
        let name = match engine {
            Engine::Slurm => {
                let printed = self.out.join("slurm-%A_%a.out");
                let mut sbatch = Command::new("sbatch");
                let told = told_by(sbatch.arg("--parsable").arg("--output").arg(printed), &text)?;
                // The cluster's name follows after a semicolon.
                told.trim().split(';').next().unwrap_or_default().to_owned()
            }
            Engine::Kubernetes => {
                let name = self.name();
                // The number of tasks of a Job cannot be changed.
                if is_unfinished(&name)? {
                    return Ok(Submitted { engine, name, is_new: false });
                }
                // Applying a finished Job again does not restart it.
                let delete = ["delete", "job", "--ignore-not-found", &name];
                told_by(Command::new("kubectl").args(delete), "")?;
                told_by(Command::new("kubectl").args(["apply", "--filename", "-"]), &text)?;
                name
            }
        };
        Ok(Submitted { engine, name, is_new: true })
    }

    fn command(&self, goalward: &Path, plans: Vec<PathBuf>, out: &Path) -> Vec<String> {
        let jobs = self.jobs.to_string();
        let shown = |path: &Path| path.display().to_string();
        let mut words = vec![shown(goalward), "experiment".to_owned()];
        words.extend(plans.iter().map(|plan| shown(plan)));
        words.extend(["--out".to_owned(), shown(out), "--jobs".to_owned(), jobs]);
        words.extend(self.flags.iter().map(|flag| (*flag).to_owned()));
        words
    }

    /// Returns the Job's name. It is the same for the same plans and folder, so that no two Jobs train them.
    fn name(&self) -> String {
        let plans = self.plans.iter().map(|plan| plan.display().to_string());
        let hash = digest::sha256(plans.chain([self.out.display().to_string()]));
        format!("goalward-experiment-{}", &hash[..8])
    }
}

impl Submitted {
    /// Returns whether the job is over.
    pub(crate) fn is_over(&self) -> bool {
        match self.engine {
            // Slurm soon forgets a finished job and then reports an invalid job id.
            Engine::Slurm => {
                let mut squeue = Command::new("squeue");
                match told_by(squeue.args(["--noheader", "--jobs", &self.name]), "") {
                    Ok(told) => told.trim().is_empty(),
                    Err(error) => error.to_string().contains("Invalid job id"),
                }
            }
            Engine::Kubernetes => {
                is_unfinished(&self.name).is_ok_and(|is_unfinished| !is_unfinished)
            }
        }
    }
}

/// Returns whether Kubernetes has a Job that has neither completed nor failed.
fn is_unfinished(job: &str) -> Result<bool> {
    let path = "--output=jsonpath={.status.conditions[?(@.status==\"True\")].type}";
    match told_by(Command::new("kubectl").args(["get", "job", job, path]), "") {
        Ok(told) => Ok(!told.contains("Complete") && !told.contains("Failed")),
        Err(error) if error.to_string().contains("NotFound") => Ok(false),
        Err(error) => Err(error),
    }
}

fn own_path() -> Result<PathBuf> {
    std::env::current_exe().context("finding goalward itself")
}

fn filled_in(text: &str, values: &[(&str, String)]) -> String {
    values
        .iter()
        .fold(text.to_owned(), |text, (name, value)| text.replace(&format!("@{name}@"), value))
}

/// Returns the key of a plan in a ConfigMap.
fn file_name(plan: &Path) -> Result<String> {
    let name = plan.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let fits = |letter: char| letter.is_ascii_alphanumeric() || "-_.".contains(letter);
    let shown = plan.display();
    ensure!(
        name.chars().all(fits),
        "{shown}: expected a name of letters, digits, -, _ and . for Kubernetes"
    );
    Ok(name)
}

/// Returns a plan as an entry of a ConfigMap.
fn entry(plan: &Path, name: &str) -> Result<String> {
    let text = std::fs::read_to_string(plan).with_context(|| plan.display().to_string())?;
    let lines = text.lines().map(|line| format!("    {line}\n"));
    Ok(format!("  {name}: |\n{}", lines.collect::<String>().trim_end()))
}

/// Runs an engine's command with `input` as its standard input and returns what it prints.
fn told_by(command: &mut Command, input: &str) -> Result<String> {
    let name = command.get_program().to_string_lossy().into_owned();
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let started = command.spawn();
    let mut child = started.with_context(|| format!("expected {name} on the path"))?;
    let written = child.stdin.take().map_or(Ok(()), |mut stdin| stdin.write_all(input.as_bytes()));
    let output = child.wait_with_output().with_context(|| name.clone())?;
    if !output.status.success() {
        bail!("{name}: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    written.with_context(|| name)?;
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(engine: Engine, plan: &Path) -> Order {
        Order {
            engine,
            tasks: 3,
            jobs: 2,
            plans: vec![plan.to_owned()],
            out: PathBuf::from("/shared/my runs"),
            flags: vec!["--quick"],
            image: "registry/goalward:1".to_owned(),
            claim: "disk".to_owned(),
        }
    }

    #[test]
    fn files_that_pods_do_not_see_are_refused() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("mine.toml");
        std::fs::write(&file, "").unwrap();
        let file = file.to_str().unwrap();
        let refused = |engine: Engine, task: &str, demonstrations: Option<&str>, out: &Path| {
            let mut config = run::tasks::configuration("navigation", None, &[]).unwrap();
            config.demonstrations.file = demonstrations.map(PathBuf::from);
            let run = PlannedRun { task: task.to_owned(), config, settings: Vec::new() };
            engine.require_files(&[run], out).err().map(|error| error.to_string())
        };
        // Tests run in the folder of this crate, which stands in for the volume.
        let here = std::env::current_dir().unwrap().join("experiments");
        for task in ["navigation", "gym:CartPole-v1", "tasks/navigation.toml"] {
            assert_eq!(refused(Engine::Kubernetes, task, None, &here), None);
        }
        let inside = place.path().join("experiments");
        let outside = Some("../Cargo.toml");
        for (task, demonstrations, out) in [
            (file, None, &here),
            ("tasks/navigation.toml", None, &inside),
            ("navigation", outside, &here),
            // Pods have it under another path.
            (file, None, &inside),
        ] {
            let message = refused(Engine::Kubernetes, task, demonstrations, out).unwrap();
            let named = demonstrations.unwrap_or(task);
            assert!(message.contains(named) && message.contains("pods"), "{message}");
            assert!(!message.contains('\n'), "{message}");
            assert_eq!(refused(Engine::Slurm, task, demonstrations, out), None);
        }
    }

    #[test]
    fn everything_is_filled_in() {
        let place = tempfile::tempdir().unwrap();
        let plan = place.path().join("plan.toml");
        std::fs::write(&plan, "title = \"A\"\nseeds = [1]\n").unwrap();
        let script = order(Engine::Slurm, &plan).text().unwrap();
        assert!(script.contains("#SBATCH --array=1-3\n#SBATCH --cpus-per-task=4\n"), "{script}");
        let shown = plan.display();
        let command = format!("experiment {shown} --out '/shared/my runs' --jobs 2 --quick &\n");
        assert!(script.contains(&command), "{script}");
        let manifests = order(Engine::Kubernetes, &plan).text().unwrap();
        for expected in [
            "data:\n  plan.toml: |\n    title = \"A\"\n    seeds = [1]\n---\n",
            "command: [\"goalward\",\"experiment\",\"/plans/plan.toml\",\"--out\",\"/runs/my runs\",",
            "requests: {cpu: \"4\", memory: 4Gi}",
            "image: registry/goalward:1\n",
            "claimName: disk\n",
        ] {
            assert!(manifests.contains(expected), "expected {expected} in\n{manifests}");
        }
        let is_left = |text: &str| text.replace("B:TERM@120", "").contains('@');
        assert!(!is_left(&script) && !is_left(&manifests));
        let wrong = place.path().join("my plan.toml");
        assert!(order(Engine::Kubernetes, &wrong).text().is_err());
    }
}
