//! Engines of clusters that train the runs of plans: what they are given, and whether it is over. They place,
//! restart and account; what there is to know of runs stays in their folders.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};
use protocol::digest;
use run::repeat::quoted;
use terminal::refusal::wrong_usage;

use crate::experiment::PlannedRun;
use crate::tasks::is_of_python;

/// What Slurm is given; words between @ are filled in.
const SCRIPT: &str = include_str!("../cluster/experiment.sh");

/// What Kubernetes is given.
const MANIFESTS: &str = include_str!("../cluster/experiment.yaml");

/// Where its pods have the volume with the folder of the runs at its top, and work.
const VOLUME: &str = "/runs";

/// Cores that a run works best with, where several run beside each other.
const CORES_OF_A_RUN: usize = 2;

/// Memory of one, GiB.
const MEMORY_OF_A_RUN_GIB: usize = 2;

/// Most tasks where nobody says how many.
const MOST_TASKS: usize = 64;

/// Flags of what a cluster does.
#[derive(Debug, clap::Args)]
pub(crate) struct Wishes {
    /// Has a cluster train what is missing; the folder of the runs is to be on a disk that all its machines see, and
    /// that has locks.
    #[arg(long, value_name = "ENGINE")]
    pub(crate) on: Option<Engine>,
    /// Tasks of the cluster's job; by default one for each run that is missing, at most 64.
    #[arg(long, requires = "on", value_parser = clap::value_parser!(u16).range(1..=1000))]
    tasks: Option<u16>,
    /// The image of Kubernetes' pods, see deploy/cluster/Dockerfile.
    #[arg(long, default_value = "goalward")]
    image: String,
    /// The claim of the volume that has the folder of the runs at its top.
    #[arg(long, default_value = "goalward-runs")]
    claim: String,
    /// Follows the runs, whoever trains them, until all are finished; Ctrl-C ends the looking on alone.
    #[arg(long, conflicts_with = "dry_run")]
    pub(crate) watch: bool,
}

/// Who places what a cluster works on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Engine {
    /// An array of jobs, by `sbatch`; SBATCH_PARTITION, SBATCH_ACCOUNT and SBATCH_TIMELIMIT say more.
    Slurm,
    /// A Job, by `kubectl`, in its own namespace.
    Kubernetes,
}

impl Engine {
    /// Checks that files of the user's own which plans name are there for whoever trains their runs into `out`.
    /// Pods see the volume alone, Slurm's jobs what this machine sees.
    ///
    /// # Errors
    /// Of wrong usage, for the first task or demonstrations that no pod would find.
    pub(crate) fn require_files(self, runs: &[PlannedRun], out: &Path) -> Result<()> {
        if self == Engine::Slurm {
            return Ok(());
        }
        let out = std::path::absolute(out).context("the folder of the runs")?;
        let volume = out.parent().unwrap_or(&out);
        for (what, file) in runs.iter().flat_map(own_files) {
            if !is_found_by_pods(file, volume) {
                return Err(wrong_usage(format!(
                    "{what} {}: expected a file in {volume}, all that pods see, named by its path \
                     from there, where the command is given, too; found one that they would not find",
                    file.display(),
                    volume = volume.display(),
                )));
            }
        }
        Ok(())
    }
}

/// The files that a plan names for a run, as it names them.
fn own_files(run: &PlannedRun) -> impl Iterator<Item = (&'static str, &Path)> {
    let is_ours = run::tasks::names().any(|name| name == run.task);
    let task = (!is_ours && !is_of_python(&run.task)).then(|| Path::new(&run.task));
    let demonstrations = run.config.demonstrations.file.as_deref();
    let task = task.map(|file| ("task", file));
    task.into_iter().chain(demonstrations.map(|file| ("demonstrations", file)))
}

/// Whether a file is the same one for a pod as it is here, where the pods' volume is at `volume`.
fn is_found_by_pods(file: &Path, volume: &Path) -> bool {
    let of_pods = Path::new(VOLUME).join(file);
    let Ok(inside) = of_pods.strip_prefix(VOLUME) else { return false };
    let there = volume.join(inside);
    let [here, there, volume] = [file, there.as_path(), volume].map(Path::canonicalize);
    let (Ok(here), Ok(there), Ok(volume)) = (here, there, volume) else { return false };
    // A link may lead out of the volume.
    here == there && here.starts_with(volume)
}

/// What an engine is to do.
#[derive(Clone, Debug)]
pub(crate) struct Order {
    engine: Engine,
    /// Tasks of the array, or pods.
    pub(crate) tasks: usize,
    /// Runs that each trains at once.
    jobs: usize,
    plans: Vec<PathBuf>,
    /// Folder of the runs.
    out: PathBuf,
    /// Flags of `goalward experiment` that go with them.
    flags: Vec<&'static str>,
    image: String,
    claim: String,
}

/// What an engine has taken.
#[derive(Clone, Debug)]
pub(crate) struct Submitted {
    engine: Engine,
    /// What the engine calls it.
    pub(crate) name: String,
}

impl Wishes {
    /// What `engine` is to do where so many runs are missing, with plans and folder by their whole paths.
    ///
    /// # Errors
    /// When a plan is not there.
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
    /// The script or the manifests.
    ///
    /// # Errors
    /// When a plan cannot be read, or its name is none for a file of a ConfigMap.
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

    /// Gives it to the engine.
    ///
    /// # Errors
    /// As [`Order::text`]; when the engine's command is not there, or it refuses.
    pub(crate) fn submit(&self) -> Result<Submitted> {
        let (engine, text) = (self.engine, self.text()?);
        let name = match engine {
            Engine::Slurm => {
                let printed = self.out.join("slurm-%A_%a.out");
                let mut sbatch = Command::new("sbatch");
                let told = told_by(sbatch.arg("--parsable").arg("--output").arg(printed), &text)?;
                // Behind a semicolon comes the cluster.
                told.trim().split(';').next().unwrap_or_default().to_owned()
            }
            Engine::Kubernetes => {
                let earlier = Submitted { engine, name: self.name() };
                // Applied again it would stay over, and may have had another number of tasks.
                if earlier.is_over() {
                    told_by(Command::new("kubectl").args(["delete", "job", &earlier.name]), "")?;
                }
                told_by(Command::new("kubectl").args(["apply", "--filename", "-"]), &text)?;
                earlier.name
            }
        };
        Ok(Submitted { engine, name })
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

    /// The same for the same plans, so that they are not trained by two Jobs.
    fn name(&self) -> String {
        let plans = self.plans.iter().map(|plan| plan.display().to_string());
        let hash = digest::sha256(plans.chain([self.out.display().to_string()]));
        format!("goalward-experiment-{}", &hash[..8])
    }
}

impl Submitted {
    /// Whether the engine has nothing of it left to do.
    pub(crate) fn is_over(&self) -> bool {
        match self.engine {
            // It soon forgets a job that is over, and says so as an error.
            Engine::Slurm => {
                let mut squeue = Command::new("squeue");
                match told_by(squeue.args(["--noheader", "--jobs", &self.name]), "") {
                    Ok(told) => told.trim().is_empty(),
                    Err(error) => error.to_string().contains("Invalid job id"),
                }
            }
            Engine::Kubernetes => {
                let path = "--output=jsonpath={.status.conditions[?(@.status==\"True\")].type}";
                let mut kubectl = Command::new("kubectl");
                let told = told_by(kubectl.args(["get", "job", &self.name, path]), "");
                told.is_ok_and(|told| told.contains("Complete") || told.contains("Failed"))
            }
        }
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

/// The name of a plan in a ConfigMap.
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

/// A plan in a ConfigMap.
fn entry(plan: &Path, name: &str) -> Result<String> {
    let text = std::fs::read_to_string(plan).with_context(|| plan.display().to_string())?;
    let lines = text.lines().map(|line| format!("    {line}\n"));
    Ok(format!("  {name}: |\n{}", lines.collect::<String>().trim_end()))
}

/// What a command of an engine says to an input.
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
        // Tests work in the folder of this crate, which plays the part of the volume.
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
