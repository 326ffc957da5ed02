//! `goalward experiment`: the runs of plans, from the first to the last that is missing.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use run::repeat::quoted;
use serde::Serialize;

use crate::cluster::{Engine, Order, Submitted, Wishes};
use crate::experiment::{
    Archive, CurveStanding, Left, PlannedRun, Watched, curves, execute, figure_of_plan, left,
    queue, read_all, refuse_other_builds, table, watch,
};
use crate::figures::Figures;
use crate::{description, destination, programs};
use terminal::print::{print_line, print_remark};
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
    /// Runs trained at once; half of the cores unless it is given. With more than one each run has
    /// one actor and one thread per process. Results do not depend on it.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=256))]
    jobs: Option<u16>,
    /// Counts runs that another build of goalward has finished and continues those that it has
    /// begun. Curves keep them apart.
    #[arg(long)]
    other_build: bool,
    /// Only say what is done, what is missing, and how many core-hours it takes; with --on what the cluster would be
    /// given.
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    cluster: Wishes,
    #[command(flatten)]
    figures: Figures,
}

/// Trains what is missing of plans.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { plans, quick, out, jobs, other_build, dry_run, .. } = arguments;
    let planned = read_all(plans, *quick)?;
    let mut archive = Archive::open(out);
    let runs = queue(&planned, &mut archive);
    destination::folder(out, true)?;
    if *dry_run {
        let left = left(&runs, &mut archive);
        if let Some(engine) = arguments.cluster.on {
            print_line(order(arguments, engine, left.runs)?.text()?.trim_end());
            return Ok(());
        }
        let (finished, words) = (runs.len() - left.runs, in_words(&left));
        let line = own_line(arguments);
        let next = format!("{finished} of {} runs are finished{words}\n  {line}", runs.len());
        return print_standing(arguments, left, &next);
    }
    if !other_build {
        refuse_other_builds(&runs, &mut archive)?;
    }
    programs::check_all()?;
    description::check_all(runs.iter().map(|run| &run.config))?;
    for folder in [archive.runs(), archive.demonstrations()] {
        fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
    }
    if arguments.cluster.on.is_some() || arguments.cluster.watch {
        return by_others(arguments, &runs, &mut archive);
    }
    let jobs = jobs.map_or_else(half_of_the_cores, usize::from);
    let ended = execute(&runs, &mut archive, jobs, *other_build)?;
    let next = if ended.is_stopped || !ended.failed.is_empty() {
        String::new()
    } else {
        format!("next:\n  {}", report_line(arguments))
    };
    print_standing(arguments, left(&runs, &mut archive), &next)?;
    if ended.is_stopped {
        print_remark(&format!("stopped; go on with\n  {}", own_line(arguments)));
        return Err(stopped());
    }
    if !ended.failed.is_empty() {
        let folder = archive.runs();
        bail!(
            "{} of {} runs failed; what each has printed is in {}/NAME.txt: {}",
            ended.failed.len(),
            runs.len(),
            folder.display(),
            ended.failed.join(", ")
        );
    }
    if !ended.elsewhere.is_empty() {
        let names = ended.elsewhere.join(", ");
        print_remark(&format!("trained by somebody else right now: {names}"));
    }
    Ok(())
}

/// Has a cluster train what is missing, if the user wishes, and looks on, likewise.
fn by_others(arguments: &Arguments, runs: &[PlannedRun], archive: &mut Archive) -> Result<()> {
    let missing = left(runs, archive).runs;
    let mut submitted = None;
    if let Some(engine) = arguments.cluster.on.filter(|_| missing > 0) {
        let order = order(arguments, engine, missing)?;
        let taken = order.submit()?;
        let (name, tasks, line) = (&taken.name, order.tasks, own_line(arguments));
        print_remark(&format!("submitted as {name}: runs: {missing}, tasks: {tasks}"));
        if !arguments.cluster.watch {
            print_remark(&format!("look on with\n  {line} --watch"));
            return Ok(());
        }
        submitted = Some(taken);
    }
    let is_over = || submitted.as_ref().is_some_and(Submitted::is_over);
    let watched = watch(runs, archive, is_over)?;
    let next = format!("next:\n  {}", report_line(arguments));
    let is_finished = watched == Watched::Finished;
    print_standing(arguments, left(runs, archive), if is_finished { &next } else { "" })?;
    match watched {
        Watched::Finished => Ok(()),
        Watched::Stopped => Err(stopped()),
        Watched::Over => bail!(
            "nobody trains what is missing any more; what each run has printed is in {}/NAME.txt",
            archive.runs().display()
        ),
    }
}

fn order(arguments: &Arguments, engine: Engine, missing: usize) -> Result<Order> {
    let Arguments { plans, out, quick, other_build, jobs, cluster, .. } = arguments;
    let flags = [(*quick, "--quick"), (*other_build, "--other-build")];
    let flags = flags.into_iter().filter_map(|(wished, flag)| wished.then_some(flag)).collect();
    cluster.order(engine, missing, jobs.map_or(1, usize::from), (plans, out), flags)
}

/// What the runs that are missing cost, and how to train them.
fn in_words(left: &Left) -> String {
    let Left { runs, core_hours, unknown } = left;
    if *runs == 0 {
        return String::new();
    }
    let others = match unknown {
        0 => String::new(),
        some => format!(", {some} aside that nobody has measured"),
    };
    format!("; {runs} more take about {core_hours:.1} core-hours{others}:")
}

fn half_of_the_cores() -> usize {
    std::thread::available_parallelism().map_or(1, |cores| (cores.get() / 2).max(1))
}

/// What of plans is done, and what is left.
#[derive(Serialize)]
struct Standing {
    curves: Vec<CurveStanding>,
    runs_left: usize,
    core_hours_left: f64,
    /// Of the runs left those whose cost nobody has measured.
    not_measured: usize,
}

/// Prints how the plans stand, and for people what is `next`.
fn print_standing(arguments: &Arguments, left: Left, next: &str) -> Result<()> {
    let figure = |plan| figure_of_plan(plan, &arguments.out, arguments.quick);
    let figures = arguments.plans.iter().map(|plan| figure(plan)).collect::<Result<Vec<_>>>()?;
    let standing = Standing {
        curves: figures.iter().flat_map(curves).collect(),
        runs_left: left.runs,
        core_hours_left: left.core_hours,
        not_measured: left.unknown,
    };
    arguments.figures.print(&standing, |standing| {
        let tables = figures.iter().map(|figure| table(figure, &standing.curves) + "\n");
        tables.collect::<String>() + next
    })
}

/// The same command again.
fn own_line(arguments: &Arguments) -> String {
    let out = quoted(arguments.out.display());
    let jobs = arguments.jobs.map_or(String::new(), |jobs| format!(" --jobs {jobs}"));
    let other_build = if arguments.other_build { " --other-build" } else { "" };
    let (goalward, plans) = (programs::own_command(), plans(arguments));
    format!("{goalward} experiment {plans}{jobs}{other_build} --out {out}")
}

/// The command that draws what is there.
fn report_line(arguments: &Arguments) -> String {
    let (goalward, out) = (programs::own_command(), quoted(arguments.out.display()));
    format!("{goalward} report {} --experiments {out} --out {out}/report --force", plans(arguments))
}

fn plans(arguments: &Arguments) -> String {
    let quick = arguments.quick.then(|| "--quick".to_owned());
    let paths = arguments.plans.iter().map(|path| quoted(path.display()));
    paths.chain(quick).collect::<Vec<_>>().join(" ")
}
