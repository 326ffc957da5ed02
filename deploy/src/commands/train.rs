//! `goalward train`: trains a run, from the first check to the last table.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use bus::{BusAddress, check_shared_memory_room};
use mcap_log::require_room;
use protocol::trajectory::Trajectory;
use run::config::{RewardConfig, RunConfig};
use run::demonstrations::file_of;
use run::folder::RunFolder;
use run::holder::Work;
use run::repeat::{self, Difference, quoted};
use run::summary::Summary;
use serde::Serialize;
use toml::Value;

use crate::companion_page::CompanionPage;
use crate::event_files::{self, EventFiles};
use crate::experiment::estimate;
use crate::listening::{ListenOptions, how_to_resume};
use crate::lock::{self, Lock};
use crate::machine::Machine;
use crate::output::Output;
use crate::output_format::OutputFormat;
use crate::prepared_run::{self, PreparedRun, TrainRequest};
use crate::programs::{self, Program};
use crate::progress::ProgressView;
use crate::supervisor::{Outcome, Source, block_on_supervision, remove_from_bus, runtime};
use crate::{choices, demonstrations, description, limits, provenance, settings, summary};
use terminal::numbers;
use terminal::print::print_remark;
use terminal::refusal::{Refusal, stopped, wrong_usage};

/// Bytes by which a run's folder can grow, with room to spare.
const DISK_BYTES: u64 = 500 << 20;

/// Gradient steps of offline training below which the user is told how to get more.
const FEW_GRADIENT_STEPS: u64 = 100;

/// Flags of `goalward train`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Task: navigation (the default), fetch-pick, fetch-push, ant-reach; the path of your own task's file; or a
    /// Python environment: gym:ID, gym:module:ID or python:module:function.
    task: Option<String>,
    /// Preset to start from: goalward (the default, on the paper's tasks our best values) or, on these tasks only,
    /// paper (the paper's tables) or authors (the settings behind the authors' published curves).
    #[arg(long, value_parser = choices::presets())]
    preset: Option<String>,
    /// Method: goal-proximity (the default), a baseline such as gail, gaifo, gaifo-s, bc, bco or sqil,
    /// or an ablation; `goalward methods` says what each is.
    #[arg(long, value_parser = choices::methods())]
    method: Option<String>,
    /// Seed of every random stream.
    #[arg(long)]
    seed: Option<u64>,
    /// Environment steps to train for.
    #[arg(long)]
    steps: Option<u64>,
    /// Fraction of the starts and goals that demonstrations may use, above 0 and at most 1.
    #[arg(long)]
    coverage: Option<f64>,
    /// Spread of the agent's starts and goals, in the task's own unit: a factor on the ranges of the demonstrations
    /// (fetch-pick, fetch-push), or half the width of the noise on the starting pose (ant-reach).
    #[arg(long)]
    noise: Option<f64>,
    /// Actor processes; their number never changes the result.
    #[arg(long)]
    actors: Option<u64>,
    /// Demonstrations to learn from; by default the task's expert records them.
    #[arg(long, value_name = "FILE.mcap")]
    demonstrations: Option<PathBuf>,
    /// Folder of the run; by default the next free runs/TASK-NUMBER.
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// Sets a configuration key, such as ppo.clip=0.3; can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// Continues the run in --run DIR from its newest checkpoint.
    #[arg(long)]
    resume: bool,
    /// Checks everything and prints what would be trained, but does not train.
    #[arg(long)]
    dry_run: bool,
    /// Writes the run's curves for TensorBoard during training, to DIR/NAME, where NAME is that of the run's folder.
    #[arg(long, value_name = "DIR")]
    tensorboard: Option<PathBuf>,
    /// Does not serve the run's web page during training; see `goalward page`.
    #[arg(long)]
    no_page: bool,
    #[command(flatten)]
    listening: ListenOptions,
    /// Continues a run although another build of goalward trained it, or a Python module of its environment has
    /// changed since. The result may then be that of neither version; the log names both.
    #[arg(long, requires = "resume")]
    other_build: bool,
    #[command(flatten)]
    output: OutputFormat,
}

impl Arguments {
    fn wishes(self) -> Result<TrainRequest> {
        let flags = [
            self.method.map(|method| format!("method={method}")),
            self.seed.map(|seed| format!("seed={seed}")),
            self.steps.map(|steps| format!("steps={steps}")),
            self.coverage.map(|share| format!("demonstrations.coverage={}", Value::Float(share))),
            self.noise.map(|noise| format!("environment.noise={}", Value::Float(noise))),
            self.actors.map(|actors| format!("resources.actors={actors}")),
            self.demonstrations.map(|file| {
                let file = Value::String(file.to_string_lossy().into_owned());
                format!("demonstrations.file={file}")
            }),
        ];
        let flags: Vec<String> = flags.into_iter().flatten().collect();
        settings::refuse_contradiction(&flags, &self.settings)?;
        let settings = [flags, self.settings].concat();
        Ok(TrainRequest { task: self.task, preset: self.preset, settings, folder: self.run })
    }
}

/// Trains a run to its end, or until the user stops it.
pub(crate) fn run(arguments: Arguments) -> Result<()> {
    let Arguments { other_build, no_page, dry_run, listening, output, .. } = arguments;
    let begin = if arguments.resume { PreparedRun::resumed_run } else { PreparedRun::new_run };
    let tensorboard = arguments.tensorboard.clone();
    let (task, settings) = (arguments.task.clone(), arguments.settings.clone());
    let mut prepared = begin(arguments.wishes()?)?;
    let check_place = |folder| event_files::check(&prepared.folder, folder, prepared.resumed);
    tensorboard.as_deref().map(check_place).transpose()?;
    if let Some(summary) = Summary::of_finished(&prepared.folder, print_remark) {
        let shown = prepared.folder.path().display();
        print_remark(&format!("the run in {shown} is finished already"));
        if !dry_run {
            clean_up_after(&prepared.folder)?;
            let write = |folder: PathBuf| EventFiles::start(&prepared.folder, &folder);
            drop(tensorboard.map(write).transpose()?);
        }
        return print_end(output, &prepared.folder, summary);
    }
    let changes = dry_run.then(|| Changes::of(&prepared.config, task.as_deref(), &settings));
    programs::check_all()?;
    listening.check(&prepared.config)?;
    prepared.config = if prepared.resumed {
        provenance::refuse_other_program(&prepared.config)?;
        description::of_begun(prepared.config, other_build)?
    } else {
        description::complete(prepared.config)?
    };
    let remarks = check(&prepared)?;
    if prepared.resumed && !other_build {
        provenance::refuse_other_build(&prepared.folder)?;
    }
    if let Some(changes) = changes {
        lock::refuse_use(&prepared.folder)?;
        remarks.iter().for_each(|remark| print_remark(remark));
        return print_dry_run(output, &prepared, changes);
    }
    if let Some(folder) = &tensorboard {
        make_event_folder(&prepared.folder, folder)?;
    }
    let mut lock = prepared.lay_out()?;
    listening.keep(&prepared.folder)?;
    let place = prepared.folder.place()?;
    let page = (!no_page).then(|| CompanionPage::start(prepared.folder.path()));
    print_start(&prepared, page.as_ref());
    remarks.iter().for_each(|remark| print_remark(remark));

    let events =
        tensorboard.map(|folder| EventFiles::start(&prepared.folder, &folder)).transpose()?;
    let mut view = ProgressView::kept_in(Output::of(&prepared.folder, "supervisor"));
    let outcome = prepare_and_supervise(&prepared, listening, &mut view);
    view.finish();
    drop(events);
    if let Err(error) = &outcome {
        // If the folder is no longer in its place, that is the cause of any failure.
        place.check()?;
        lock.keep_failure(format!("{error:#}"));
    }
    // The page lists the run once more as it ends, and must not find it held.
    drop(lock);
    drop(page);
    conclude(outcome?, output, &prepared.folder)
}

/// Tells the user how a run has ended.
fn conclude(outcome: Outcome, output: OutputFormat, folder: &RunFolder) -> Result<()> {
    match outcome {
        Outcome::Finished => {
            let summary = Summary::of_run(folder)?.context("the learner left no summary")?;
            print_end(output, folder, summary)
        }
        Outcome::Stopped => {
            let (shown, how) = (quoted(folder.path().display()), how_to_resume(folder));
            print_remark(&format!("stopped; the run is in {shown}. Continue it with\n  {how}"));
            Err(stopped())
        }
        Outcome::EndOfLog => Ok(()),
    }
}

fn print_dry_run(output: OutputFormat, prepared: &PreparedRun, changes: Changes) -> Result<()> {
    let doing = if prepared.resumed { "would continue" } else { "would train" };
    let start = start_line(prepared, doing);
    let dry = DryRun::of(prepared, changes);
    output.print(&dry, |dry| format!("{start}\n{}", dry.changes.table()))
}

/// Checks everything that can be checked before the run has a folder. Returns remarks for the user.
fn check(prepared: &PreparedRun) -> Result<Vec<String>> {
    let long = Machine::here().require_room_for(&prepared.config)?;
    let file = file_of(&prepared.folder, &prepared.config);
    let is_given = prepared.config.demonstrations.file.is_some();
    let mut short = None;
    if is_given {
        let shown =
            run::demonstrations::of_file(&file, &prepared.config).map_err(Refusal::usage)?;
        short = (!prepared.resumed)
            .then(|| remark_on_offline_training(&prepared.config, &shown))
            .flatten();
    }
    if prepared.resumed && file.exists() {
        let unchanged = run::origin::demonstrations_sha256(&prepared.folder, &prepared.config);
        unchanged.map_err(Refusal::usage)?;
    }
    require_room(&existing_part(prepared.folder.path()), DISK_BYTES)?;
    check_shared_memory_room(limits::SHARED_MEMORY_BYTES)?;
    limits::check(prepared.config.resources.actors)?;
    let remark =
        is_given.then(|| demonstrations::remark(&file, &prepared.config.task)).transpose()?;
    Ok(long.into_iter().chain(remark.flatten()).chain(short).collect())
}

/// Returns a remark if offline training on these demonstrations has so few gradient steps that it teaches little.
fn remark_on_offline_training(config: &RunConfig, shown: &[Trajectory]) -> Option<String> {
    let RewardConfig { model, input, batch, pretraining_epochs: epochs, .. } = config.reward;
    let rows: u64 = shown.iter().map(|one| model.rows(input, u64::from(one.steps))).sum();
    // Every epoch has as many full batches as the rows fill.
    let per_epoch = rows / batch as u64;
    let steps = per_epoch.saturating_mul(epochs);
    let trains = model.trains && !model.is_discriminator() && steps > 0;
    if !trains || steps >= FEW_GRADIENT_STEPS {
        return None;
    }
    let enough = FEW_GRADIENT_STEPS.div_ceil(per_epoch);
    Some(format!(
        "offline training has {} ({rows} rows, reward.batch={batch}, {}); --set \
         reward.pretraining_epochs={enough} makes {}",
        several(steps, "gradient step"),
        several(epochs, "epoch"),
        enough * per_epoch
    ))
}

/// Returns a number with what it counts.
fn several(count: u64, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

/// Makes the folder of a run's event file. This is done before the run has a folder, so that a refusal leaves none.
fn make_event_folder(run: &RunFolder, folder: &Path) -> Result<()> {
    let place = event_files::of_run(run, folder)?;
    fs::create_dir_all(&place).map_err(|error| {
        let shown = place.display();
        wrong_usage(format!(
            "--tensorboard: expected a folder that can be made, found {shown}: {error}"
        ))
    })
}

fn prepare_and_supervise(
    prepared: &PreparedRun,
    listening: ListenOptions,
    view: &mut ProgressView,
) -> Result<Outcome> {
    let PreparedRun { folder, config, .. } = prepared;
    if config.imitates() && !file_of(folder, config).exists() {
        let episodes = numbers::count(config.demonstrations.episodes);
        view.activity(&format!("recording {episodes} demonstrations"));
        if !demonstrations::record_for_run(folder, config)? {
            return Ok(Outcome::Stopped);
        }
    }
    let program = Program::acting_in(&config.task);
    let listening = listening.prepare(folder, &config.task)?;
    if let Some(listening) = &listening {
        view.note(&listening.how_to_join(folder));
    }
    let source = Source::Environments { count: config.resources.actors, program, listening };
    block_on_supervision(folder, &source, view)
}

/// Removes what a run left in shared memory if it finished after its supervisor was killed.
fn clean_up_after(folder: &RunFolder) -> Result<()> {
    // If another process holds the lock, the supervisor still lives and does this itself.
    let Ok(_lock) = Lock::take(folder, Work::CleaningUp) else { return Ok(()) };
    let Some(address) = BusAddress::if_started(folder.path())? else { return Ok(()) };
    runtime()?.block_on(remove_from_bus(&address))
}

/// Returns the deepest existing folder on the way to `path`.
fn existing_part(path: &Path) -> PathBuf {
    let existing = path.ancestors().find(|part| part.is_dir());
    existing.unwrap_or(Path::new(".")).to_owned()
}

fn print_start(prepared: &PreparedRun, page: Option<&Result<CompanionPage>>) {
    let line = start_line(prepared, if prepared.resumed { "continuing" } else { "training" });
    match page {
        Some(Ok(page)) => print_remark(&format!("{line}; {}", page.address())),
        Some(Err(why)) => {
            print_remark(&line);
            let (goalward, shown) =
                (programs::own_command(), quoted(prepared.folder.path().display()));
            print_remark(&format!("no page: {why:#}; {goalward} page {shown} serves one"));
        }
        None => print_remark(&line),
    }
}

fn start_line(prepared: &PreparedRun, doing: &str) -> String {
    let config = &prepared.config;
    let RunConfig { task, method, preset, seed, resources, .. } = config;
    format!(
        "{doing} {task} with {method} in {}: preset {preset}, seed {seed}, {} steps, actors: {}",
        prepared.folder.path().display(),
        numbers::count(config.steps_wanted()),
        resources.actors,
    )
}

/// A run that is not trained yet.
#[derive(Debug, Serialize)]
struct DryRun {
    run: PathBuf,
    task: String,
    method: String,
    preset: String,
    seed: u64,
    steps: u64,
    #[serde(flatten)]
    changes: Changes,
}

impl DryRun {
    fn of(prepared: &PreparedRun, changes: Changes) -> DryRun {
        let config = &prepared.config;
        DryRun {
            run: prepared.folder.path().to_owned(),
            task: config.task.name.clone(),
            method: config.method.clone(),
            preset: config.preset.clone(),
            seed: config.seed,
            steps: config.steps_wanted(),
            changes,
        }
    }
}

/// How a run differs from the defaults of its task, preset and method, and what it costs.
#[derive(Debug, Serialize)]
struct Changes {
    settings: Vec<Difference>,
    /// Core-seconds, if they were measured.
    processor_s: Option<f64>,
}

impl Changes {
    fn of(config: &RunConfig, task: Option<&str>, settings: &[String]) -> Changes {
        // The defaults of a user's own task can be read only by the name that the user gave.
        let usual = task.and_then(|task| prepared_run::usual(task, config, settings).ok());
        let settings = usual
            .map_or_else(|| repeat::differences(config), |usual| repeat::changes(config, &usual));
        Changes { settings, processor_s: estimate::measured(config) }
    }

    fn table(&self) -> String {
        let row = |Difference { key, value, default }: &Difference| {
            [key.clone(), value.clone(), format!("(default {default})")]
        };
        let mut rows: Vec<_> = self.settings.iter().map(row).collect();
        if let Some(core_s) = self.processor_s {
            let core_s = numbers::duration(core_s.max(1.0));
            rows.push(["processor time".to_owned(), format!("about {core_s}"), String::new()]);
        }
        numbers::columns(&rows)
    }
}

/// A finished run.
#[derive(Debug, Serialize)]
struct Finished {
    run: PathBuf,
    #[serde(flatten)]
    summary: Summary,
}

fn print_end(output: OutputFormat, folder: &RunFolder, summary: Summary) -> Result<()> {
    let finished = Finished { run: folder.path().to_owned(), summary };
    output.print(&finished, |Finished { run, summary }| {
        let (goalward, shown) = (programs::own_command(), quoted(run.display()));
        format!(
            "{}  files  {shown}: config.toml, summary.json, log/, checkpoints/, output/\n\
             next:\n  {goalward} evaluate {shown}\n  {goalward} page {shown}\n  {goalward} log info {shown}",
            summary::table(summary)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flags_become_settings() {
        let arguments = Arguments {
            task: None,
            preset: None,
            method: Some("environment-reward".to_owned()),
            seed: Some(3),
            steps: Some(10_000),
            coverage: Some(1.0),
            noise: None,
            actors: Some(4),
            demonstrations: None,
            run: None,
            settings: vec!["ppo.clip=0.3".to_owned()],
            resume: false,
            tensorboard: None,
            no_page: false,
            dry_run: false,
            listening: ListenOptions::default(),
            other_build: false,
            output: OutputFormat::default(),
        };
        let settings = arguments.wishes().unwrap().settings;
        let config = run::tasks::configuration("navigation", None, &settings).unwrap();
        assert_eq!((config.seed, config.steps, config.resources.actors), (3, 10_000, 4));
        let coverage = config.demonstrations.environment.0["coverage"].as_float();
        assert_eq!((coverage, config.ppo.clip), (Some(1.0), 0.3));
    }

    #[test]
    fn a_few_steps_of_offline_training_are_remarked_on() {
        let remark = |settings: &[&str], steps: u32| {
            let settings: Vec<String> =
                settings.iter().map(|&setting| setting.to_owned()).collect();
            let config = run::tasks::configuration("navigation", None, &settings).unwrap();
            let shown = Trajectory { steps, ..Trajectory::default() };
            remark_on_offline_training(&config, &[shown])
        };
        let usual = ["reward.batch=32", "reward.pretraining_epochs=5"];
        assert_eq!(
            remark(&usual, 40).unwrap(),
            "offline training has 5 gradient steps (41 rows, reward.batch=32, 5 epochs); --set \
             reward.pretraining_epochs=100 makes 100"
        );
        assert_eq!(remark(&usual, 640), None);
        assert_eq!(remark(&["method=gail"], 40), None);
        assert_eq!(remark(&["method=no-offline"], 40), None);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_refused_before_the_run_has_one() {
        let directory = tempfile::tempdir().unwrap();
        let run = RunFolder::new(directory.path().join("one"));
        make_event_folder(&run, &directory.path().join("curves")).unwrap();
        assert!(directory.path().join("curves/one").is_dir());
        let said = make_event_folder(&run, Path::new("/proc/x")).unwrap_err().to_string();
        assert!(said.contains("--tensorboard") && said.contains("/proc/x/one"), "{said}");
        assert!(!run.path().exists());
    }

    #[test]
    fn room_is_asked_for_where_the_folder_will_be() {
        let directory = tempfile::tempdir().unwrap();
        assert_eq!(existing_part(&directory.path().join("a/b")), directory.path());
        assert_eq!(existing_part(Path::new("surely/not/there")), Path::new("."));
    }
}
