//! The routes below `/api` and their responses, mostly JSON.

use std::convert::Infallible;
use std::sync::Arc;

use anyhow::Result;
use axum::extract::{Path, Query, State};
use axum::http::{StatusCode, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use run::folder::RunFolder;
use serde::{Deserialize, Serialize};
use tokio_stream::StreamExt;
use tokio_stream::wrappers::WatchStream;

use crate::listed::List;
use crate::output::Output;
use crate::runs::Runs;
use crate::shown::Asked;
use crate::state::{Pages, Refused, WATCHERS};

type Answer = Result<Response, Refused>;
type Shared = State<Arc<Pages>>;

/// Returns the routes below `/api`.
pub(crate) fn routes() -> Router<Arc<Pages>> {
    Router::new()
        .route("/runs", get(list))
        .route("/events", get(events))
        .route("/runs/{id}", get(details))
        .route("/runs/{id}/updates", get(updates))
        .route("/runs/{id}/processes", get(processes))
        .route("/runs/{id}/output", get(output))
        .route("/runs/{id}/episodes/{collection}", get(episodes))
        .route("/runs/{id}/episodes/{collection}/{row}", get(episode))
        .route("/runs/{id}/episodes/{collection}/{row}/scenes", get(scenes))
        .route("/runs/{id}/episodes/{collection}/{row}/pictures", get(pictures))
        .route("/runs/{id}/episodes/{collection}/{row}/proximity", get(proximity))
        .route("/runs/{id}/episodes/{collection}/{row}/grid", get(grid))
        .route("/runs/{id}/episodes/{collection}/{row}/reward", get(reward))
}

async fn list(State(pages): Shared) -> Result<Json<List>, Refused> {
    Ok(Json(pages.read(Runs::list).await?))
}

/// Sends the list of runs now and whenever it has changed. A slow browser may miss lists, but never the newest.
async fn events(State(pages): Shared) -> Result<impl IntoResponse, Refused> {
    let place = Arc::clone(&pages.watchers).try_acquire_owned().map_err(|_taken| {
        let line = format!("{WATCHERS} browsers are told of changes already");
        Refused(StatusCode::SERVICE_UNAVAILABLE, line)
    })?;
    let changes = WatchStream::from_changes(pages.newest.subscribe());
    let now = Arc::new(pages.read(Runs::list).await?);
    let lists = tokio_stream::once(now).chain(changes).map(move |list| {
        let _held = &place;
        let event = Event::default().event("runs").json_data(&*list);
        Ok::<_, Infallible>(event.unwrap_or_default())
    });
    Ok(Sse::new(lists).keep_alive(KeepAlive::default()))
}

async fn details(State(pages): Shared, Path(id): Path<String>) -> Answer {
    of_run(pages, id, |runs, id, folder| json(&runs.details(id, folder)?)).await
}

/// The first row requested, and the generation of the rows that the browser has.
#[derive(Deserialize)]
struct FirstRow {
    #[serde(default)]
    from: usize,
    #[serde(default)]
    generation: u64,
}

async fn updates(
    State(pages): Shared,
    Path(id): Path<String>,
    Query(FirstRow { from, .. }): Query<FirstRow>,
) -> Answer {
    of_run(pages, id, move |runs, _, folder| json(&runs.curves(folder).from(from))).await
}

async fn processes(State(pages): Shared, Path(id): Path<String>) -> Answer {
    of_run(pages, id, |runs, _, folder| json(&runs.shown.processes(folder)?)).await
}

async fn output(State(pages): Shared, Path(id): Path<String>) -> Answer {
    of_run(pages, id, |_, _, folder| json(&Output::of(folder))).await
}

async fn episodes(
    State(pages): Shared,
    Path((id, collection)): Path<(String, String)>,
    Query(FirstRow { from, generation }): Query<FirstRow>,
) -> Answer {
    let read = move |runs: &Runs, _: &str, folder: &RunFolder| {
        let found = runs.shown.rows(folder, &collection, generation, from)?;
        found.ok_or_else(|| Refused::unknown(format!("there is no collection {collection}")))
    };
    of_run(pages, id, read).await
}

async fn episode(
    State(pages): Shared,
    Path((id, collection, row)): Path<(String, String, usize)>,
) -> Answer {
    of_episode(pages, id, collection, row, |_, asked| json(&asked.episode())).await
}

async fn scenes(
    State(pages): Shared,
    Path((id, collection, row)): Path<(String, String, usize)>,
) -> Answer {
    of_episode(pages, id, collection, row, |runs, asked| json(&runs.shown.scenes(&asked)?)).await
}

async fn pictures(
    State(pages): Shared,
    Path((id, collection, row)): Path<(String, String, usize)>,
) -> Answer {
    let ask = |runs: &Runs, asked: Asked| Ok(runs.shown.pictures(&asked)?);
    let found = answer_of_episode(pages, id, collection, row, ask).await?;
    Ok(([(header::CONTENT_TYPE, "application/octet-stream")], found).into_response())
}

/// The checkpoint whose reward model is queried; by default the newest.
#[derive(Deserialize)]
struct Model {
    checkpoint: Option<u64>,
}

impl Model {
    /// Returns the checkpoint.
    ///
    /// # Errors
    /// When the run has no such checkpoint.
    fn of(self, asked: &Asked) -> Result<Option<u64>, Refused> {
        match self.checkpoint {
            Some(number) if !asked.has_checkpoint(number) => {
                Err(Refused::unknown(format!("there is no checkpoint {number}")))
            }
            checkpoint => Ok(checkpoint),
        }
    }
}

async fn proximity(
    State(pages): Shared,
    Path((id, collection, row)): Path<(String, String, usize)>,
    Query(model): Query<Model>,
) -> Answer {
    let ask = move |runs: &Runs, asked: Asked| {
        let checkpoint = model.of(&asked)?;
        json(&runs.shown.proximity(&asked, checkpoint)?)
    };
    of_episode(pages, id, collection, row, ask).await
}

async fn grid(
    State(pages): Shared,
    Path((id, collection, row)): Path<(String, String, usize)>,
    Query(model): Query<Model>,
) -> Answer {
    let ask = move |runs: &Runs, asked: Asked| {
        let checkpoint = model.of(&asked)?;
        json(&runs.shown.grid(&asked, checkpoint)?)
    };
    of_episode(pages, id, collection, row, ask).await
}

/// Another reward: changes of the configuration, separated by spaces, and the run whose trained model scores.
#[derive(Deserialize)]
struct Otherwise {
    #[serde(default)]
    with: String,
    model: Option<String>,
}

async fn reward(
    State(pages): Shared,
    Path((id, collection, row)): Path<(String, String, usize)>,
    Query(Otherwise { with, model }): Query<Otherwise>,
) -> Answer {
    let ask = move |runs: &Runs, asked: Asked| {
        let changes: Vec<String> = with.split_whitespace().map(str::to_owned).collect();
        if let Some(change) = changes.iter().find(|change| change.starts_with("model=")) {
            let words = format!(
                "with: expected keys of the reward, found {change}; the run is the parameter `model`"
            );
            return Err(Refused(StatusCode::BAD_REQUEST, words));
        }
        let found = |name: String| {
            let unknown = || Refused::unknown(format!("no run is called {name}"));
            runs.folder(&name).ok_or_else(unknown)
        };
        let model = model.map(found).transpose()?;
        let score = runs.shown.score(&asked, model.as_ref(), changes);
        json(&score.map_err(Refused::of_settings)?)
    };
    of_episode(pages, id, collection, row, ask).await
}

/// Responds with the JSON that `read` returns for a run.
async fn of_run(
    pages: Arc<Pages>,
    id: String,
    read: impl FnOnce(&Runs, &str, &RunFolder) -> Result<String, Refused> + Send + 'static,
) -> Answer {
    let found = pages.read(move |runs| in_run(runs, &id, read)).await??;
    Ok(([(header::CONTENT_TYPE, "application/json")], found).into_response())
}

fn in_run<T>(
    runs: &Runs,
    id: &str,
    read: impl FnOnce(&Runs, &str, &RunFolder) -> Result<T, Refused>,
) -> Result<T, Refused> {
    match runs.folder(id) {
        Some(folder) => read(runs, id, &folder),
        None => Err(Refused::unknown(format!("no run is called {id}"))),
    }
}

/// Responds with the JSON that `read` returns for an episode of a run.
async fn of_episode(
    pages: Arc<Pages>,
    id: String,
    collection: String,
    row: usize,
    read: impl FnOnce(&Runs, Asked) -> Result<String, Refused> + Send + 'static,
) -> Answer {
    let found = answer_of_episode(pages, id, collection, row, read).await?;
    Ok(([(header::CONTENT_TYPE, "application/json")], found).into_response())
}

async fn answer_of_episode<T: Send + 'static>(
    pages: Arc<Pages>,
    id: String,
    collection: String,
    row: usize,
    read: impl FnOnce(&Runs, Asked) -> Result<T, Refused> + Send + 'static,
) -> Result<T, Refused> {
    let ask = move |runs: &Runs, _: &str, folder: &RunFolder| {
        let asked = runs.shown.asked(folder, &collection, row)?;
        let unknown = || Refused::unknown(format!("there is no episode {row} in {collection}"));
        read(runs, asked.ok_or_else(unknown)?)
    };
    pages.play(move |runs| in_run(runs, &id, ask)).await?
}

fn json(answer: &impl Serialize) -> Result<String, Refused> {
    Ok(serde_json::to_string(answer).map_err(anyhow::Error::new)?)
}
