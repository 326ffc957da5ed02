//! The state of a run, for programs.

use std::path::PathBuf;

use protocol::messages::{PolicyUpdate, Progress};
use serde_json::{Value, json};

use super::table::{doing, trouble};
use super::{Standing, Status, Stopped};

impl Status {
    /// Returns what the run is, its state, and the figures of this state. Unknown numbers are null.
    pub(super) fn figures(&self) -> Value {
        let config = &self.config;
        let (state, mut figures) = match &self.standing {
            Standing::Live { processes, progress, times, hosts } => {
                let heard = progress.as_ref().map_or(&[][..], |progress| &progress.actors_heard);
                let figures = json!({
                    "trouble": trouble(processes, progress.as_deref()),
                    "progress": progress.as_deref().map(of_progress),
                    "checkpoint": of_checkpoint(self.folder.newest_checkpoint().as_ref()),
                    "time_to_success": times,
                    "processes": processes.figures(heard),
                    "hosts": hosts.present,
                    "expelled": hosts.expelled,
                });
                ("training", figures)
            }
            Standing::Finished(summary) => ("finished", json!({ "summary": summary })),
            Standing::Beginning { records } => {
                ("starting", json!({ "records_demonstrations": records }))
            }
            Standing::Elsewhere { trainer, progress, age, times } => {
                let figures = json!({
                    "trainer": trainer,
                    "progress": progress.as_deref().map(of_progress),
                    "progress_age_s": age.as_secs_f64(),
                    "checkpoint": of_checkpoint(self.folder.newest_checkpoint().as_ref()),
                    "time_to_success": times,
                });
                ("training", figures)
            }
            Standing::Stopped(stopped) => {
                let state = if stopped.failure.is_some() { "failed" } else { "stopped" };
                (state, of_stopped(stopped))
            }
        };
        figures["run"] = json!(self.folder.path());
        figures["state"] = json!(state);
        figures["task"] = json!(config.task.name);
        figures["method"] = json!(config.method);
        figures["preset"] = json!(config.preset);
        figures["seed"] = json!(config.seed);
        figures["steps_wanted"] = json!(config.steps_wanted());
        figures
    }
}

fn of_progress(progress: &Progress) -> Value {
    let learned = progress.reward_update.as_ref().filter(|update| update.model_version > 0);
    let reward_model = learned.map(|update| {
        json!({
            "demonstration_loss": update.demonstration_loss,
            "agent_loss": update.agent_loss,
            "gradient_steps": update.gradient_steps,
        })
    });
    json!({
        "doing": doing(progress),
        "update": progress.update.as_ref().map(of_update),
        "reward_model": reward_model,
        "actors": progress.actors,
        "leases": progress.leases,
        "wall_s": progress.wall_s,
        "log_bytes": progress.log_bytes,
    })
}

fn of_update(update: &PolicyUpdate) -> Value {
    json!({
        "environment_steps": update.environment_steps,
        "iterations": update.iteration + 1,
        "episodes": update.episodes,
        "success_rate": update.success_rate,
        "approximate_kl": update.approximate_kl,
        "policy_loss": update.policy_loss,
        "held_out_loss": update.held_out_loss,
        "value_loss": update.value_loss,
    })
}

fn of_checkpoint(newest: Option<&(u64, PathBuf)>) -> Option<Value> {
    newest.map(|(iteration, folder)| json!({ "iteration": iteration, "folder": folder }))
}

fn of_stopped(stopped: &Stopped) -> Value {
    let Stopped { holder, failure, begun, newest, damaged, unreadable, update, times } = stopped;
    json!({
        "holder": holder,
        "failure": failure,
        "begun": begun,
        "unreadable": unreadable.as_ref().map(ToString::to_string),
        "checkpoint": of_checkpoint(newest.as_ref()),
        "damaged": damaged.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "update": update.as_ref().map(of_update),
        "time_to_success": times,
    })
}
