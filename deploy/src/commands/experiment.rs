//! `goalward experiment`: trains the missing runs of plans.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use run::repeat::quoted;
use serde::Serialize;

use crate::cluster::{ClusterArguments, Engine, Order, Submitted};
use crate::experiment::{
    Archive, CurveStanding, Left, Plan, PlannedRun, Watched, curves, execute, figure_of, left,
    queue, read_all, refuse_other_builds, refuse_other_demonstrations, table, watch,
};
use crate::output_format::OutputFormat;
use crate::{description, destination, programs};
use terminal::print::print_remark;
use terminal::refusal::stopped;

/// Flags of `goalward experiment`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Plans, such as deploy/experiments/figure3.toml. Runs that several of them need are trained
    /// once.
    #[arg(required = true, value_name = "PLAN.toml")]
    plans: Vec<PathBuf>,
    /// The plans at their reduced size.
    #[arg(long)]
    quick: bool,
    /// Folder of the runs and the demonstrations.
    #[arg(long, value_name = "DIR", default_value = "experiments")]
    out: PathBuf,
    /// Runs to train at once; by default half the number of cores, on a cluster one in each task. With more than one,
    /// each run has one actor and one thread per process. Results do not depend on it.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Counts runs that another build of goalward finished, and continues those that it began. Curves keep the builds
    /// apart.
    #[arg(long)]
    other_build: bool,
    /// Only prints what is done, what is missing and how many core-hours it takes; with --on, what would be submitted
    /// to the cluster.
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    cluster: ClusterArguments,
    #[command(flatten)]
    output: OutputFormat,
}

/// The runs that plans ask for, and the folder that they are in.
struct Planned {
    plans: Vec<Plan>,
    runs: Vec<PlannedRun>,
    archive: Archive,
}

impl Planned {
    fn left(&mut self) -> Left {
        left(&self.runs, &mut self.archive)
    }
}

/// Trains the missing runs of plans.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { plans, quick, out, jobs, other_build, dry_run, .. } = arguments;
    let plans = read_all(plans, *quick)?;
    let mut archive = Archive::open(out);
    let runs = queue(&plans, &mut archive);
    destination::folder(out, true)?;
    if !other_build {
        refuse_other_builds(&runs, &mut archive)?;
    }
    refuse_other_demonstrations(&runs, &mut archive)?;
    programs::check_all()?;
    description::check_all(runs.iter().map(|run| &run.config))?;
    if let Some(engine) = arguments.cluster.on {
        engine.require_files(&runs, out)?;
    }
    let mut planned = Planned { plans, runs, archive };
    if *dry_run {
        return tell_what_is_missing(arguments, &mut planned);
    }
    let Planned { runs, archive, .. } = &mut planned;
    for folder in [archive.runs(), archive.demonstrations()] {
        fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
    }
    if arguments.cluster.on.is_some() || arguments.cluster.watch {
        return by_others(arguments, &mut planned);
    }
    let jobs = jobs.map_or_else(half_of_the_cores, usize::from);
    let ended = execute(runs, archive, jobs, *other_build)?;
    let is_whole = !ended.is_stopped && ended.failed.is_empty() && ended.elsewhere.is_empty();
    let next =
        if is_whole { format!("next:\n  {}", report_line(arguments)) } else { String::new() };
    let left = planned.left();
    print_standing(arguments, &mut planned, left, &next)?;
    if ended.is_stopped {
        print_remark(&format!("stopped; continue with\n  {}", own_line(arguments)));
    }
    if ended.is_stopped && ended.failed.is_empty() {
        return Err(stopped());
    }
    if !ended.failed.is_empty() {
        let folder = planned.archive.runs();
        bail!(
            "{} of {} runs failed: {}; the output of each is in {}/NAME.txt",
            ended.failed.len(),
            planned.runs.len(),
            ended.failed.join(", "),
            folder.display()
        );
    }
    if !ended.elsewhere.is_empty() {
        let names = ended.elsewhere.join(", ");
        print_remark(&format!("being trained by another process: {names}"));
    }
    Ok(())
}

/// Prints what this machine, or a cluster, would do.
fn tell_what_is_missing(arguments: &Arguments, planned: &mut Planned) -> Result<()> {
    let left = planned.left();
    if let Some(engine) = arguments.cluster.on.filter(|_| left.runs > 0) {
        let text = order(arguments, engine, left.runs)?.text()?;
        return arguments.output.print(&text, String::clone);
    }
    let all = planned.runs.len();
    let (finished, words, line) = (all - left.runs, in_words(&left), own_line(arguments));
    let next = format!("{finished} of {all} runs are finished{words}\n  {line}");
    print_standing(arguments, planned, left, &next)
}

/// Has a cluster train the missing runs and shows their progress, each if the user asks for it.
fn by_others(arguments: &Arguments, planned: &mut Planned) -> Result<()> {
    let missing = planned.left().runs;
    let look_on = format!("show the progress with\n  {} --watch", own_line(arguments));
    let mut submitted = None;
    if let Some(engine) = arguments.cluster.on.filter(|_| missing > 0) {
        let order = order(arguments, engine, missing)?;
        let taken = order.submit()?;
        let (name, tasks) = (&taken.name, order.tasks);
        print_remark(&match taken.is_new {
            true => format!("submitted as {name}: runs: {missing}, tasks: {tasks}"),
            false => format!("{name} is still there and is left as it is; runs missing: {missing}"),
        });
        if !arguments.cluster.watch {
            print_remark(&look_on);
            return Ok(());
        }
        submitted = Some(taken);
    }
    let is_over = || submitted.as_ref().is_some_and(Submitted::is_over);
    let watched = watch(&planned.runs, &mut planned.archive, is_over)?;
    let next = format!("next:\n  {}", report_line(arguments));
    let next = if watched == Watched::Finished { next.as_str() } else { "" };
    let left = planned.left();
    print_standing(arguments, planned, left, next)?;
    match watched {
        Watched::Finished => Ok(()),
        Watched::Stopped => {
            print_remark(&look_on);
            Err(stopped())
        }
        Watched::Over => bail!(
            "the missing runs are no longer being trained; the output of each run is in {}/NAME.txt",
            planned.archive.runs().display()
        ),
    }
}

fn order(arguments: &Arguments, engine: Engine, missing: usize) -> Result<Order> {
    let Arguments { plans, out, quick, other_build, jobs, cluster, .. } = arguments;
    let flags = [(*quick, "--quick"), (*other_build, "--other-build")];
    let flags = flags.into_iter().filter_map(|(wished, flag)| wished.then_some(flag)).collect();
    cluster.order(engine, missing, jobs.map_or(1, usize::from), (plans, out), flags)
}

/// Says what the missing runs cost.
fn in_words(left: &Left) -> String {
    let Left { runs, core_hours, unknown } = left;
    if *runs == 0 {
        return String::new();
    }
    let others = match unknown {
        0 => String::new(),
        some => format!(", not counting {some} with unknown costs"),
    };
    format!("; {runs} more take about {core_hours:.1} core-hours{others}:")
}

fn half_of_the_cores() -> usize {
    std::thread::available_parallelism().map_or(1, |cores| (cores.get() / 2).max(1))
}

/// The state of plans: what is done, and what is left.
#[derive(Serialize)]
struct Standing {
    curves: Vec<CurveStanding>,
    runs_left: usize,
    core_hours_left: f64,
    /// Runs left whose cost was not measured.
    not_measured: usize,
}

/// Prints the state of the plans and, for people, `next`.
fn print_standing(
    arguments: &Arguments,
    planned: &mut Planned,
    left: Left,
    next: &str,
) -> Result<()> {
    let figures: Vec<_> =
        planned.plans.iter().map(|plan| figure_of(plan, &mut planned.archive)).collect();
    let standing = Standing {
        curves: figures.iter().flat_map(curves).collect(),
        runs_left: left.runs,
        core_hours_left: left.core_hours,
        not_measured: left.unknown,
    };
    arguments.output.print(&standing, |standing| {
        let tables = figures.iter().map(|figure| table(figure, &standing.curves) + "\n");
        tables.collect::<String>() + next
    })
}

/// Returns the command that runs the same experiment again on this machine.
fn own_line(arguments: &Arguments) -> String {
    let out = quoted(arguments.out.display());
    let jobs = arguments.jobs.map_or(String::new(), |jobs| format!(" --jobs {jobs}"));
    let other_build = if arguments.other_build { " --other-build" } else { "" };
    let (goalward, plans) = (programs::own_command(), plans(arguments));
    format!("{goalward} experiment {plans}{jobs}{other_build} --out {out}")
}

/// Returns the command that makes a report of the runs so far.
fn report_line(arguments: &Arguments) -> String {
    let (goalward, out) = (programs::own_command(), quoted(arguments.out.display()));
    format!("{goalward} report {} --experiments {out} --out {out}/report --force", plans(arguments))
}

fn plans(arguments: &Arguments) -> String {
    let quick = arguments.quick.then(|| "--quick".to_owned());
    let paths = arguments.plans.iter().map(|path| quoted(path.display()));
    paths.chain(quick).collect::<Vec<_>>().join(" ")
}
