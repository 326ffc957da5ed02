//! What all answers share: the runs, who may ask, how many may read at once.

use std::sync::Arc;

use anyhow::Result;
use axum::Json;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde_json::json;
use tokio::sync::{Semaphore, watch};

use crate::guard::Guard;
use crate::listed::List;
use crate::runs::Runs;

/// Questions that read files at the same time; the others wait.
const READERS: usize = 4;

/// Questions of single episodes at the same time: most of them start a program, beside a training.
const PLAYERS: usize = 2;

/// Browsers that are told of changes at the same time.
pub(crate) const WATCHERS: usize = 64;

/// What all answers share.
pub(crate) struct Pages {
    runs: Runs,
    pub(crate) guard: Guard,
    readers: Arc<Semaphore>,
    players: Arc<Semaphore>,
    pub(crate) watchers: Arc<Semaphore>,
    pub(crate) newest: watch::Sender<Arc<List>>,
}

impl Pages {
    /// Before the first question.
    pub(crate) fn new(runs: Runs, guard: Guard) -> Pages {
        Pages {
            runs,
            guard,
            readers: Arc::new(Semaphore::new(READERS)),
            players: Arc::new(Semaphore::new(PLAYERS)),
            watchers: Arc::new(Semaphore::new(WATCHERS)),
            newest: watch::Sender::new(Arc::default()),
        }
    }

    /// Reads files without holding up the other answers.
    pub(crate) async fn read<T: Send + 'static>(
        self: &Arc<Self>,
        read: impl FnOnce(&Runs) -> T + Send + 'static,
    ) -> Result<T> {
        self.take_turn(&self.readers, read).await
    }

    /// Plays an episode without holding up those who read.
    pub(crate) async fn play<T: Send + 'static>(
        self: &Arc<Self>,
        play: impl FnOnce(&Runs) -> T + Send + 'static,
    ) -> Result<T> {
        self.take_turn(&self.players, play).await
    }

    /// Does a piece of work when it is its turn, which lasts until it is done: nobody may be waiting for the
    /// answer any more.
    async fn take_turn<T: Send + 'static>(
        self: &Arc<Self>,
        turns: &Arc<Semaphore>,
        work: impl FnOnce(&Runs) -> T + Send + 'static,
    ) -> Result<T> {
        let turn = Arc::clone(turns).acquire_owned().await?;
        let pages = Arc::clone(self);
        let work = move || {
            let _turn = turn;
            work(&pages.runs)
        };
        Ok(tokio::task::spawn_blocking(work).await?)
    }
}

/// What a question without an answer gets: a line.
pub(crate) struct Refused(pub(crate) StatusCode, pub(crate) String);

impl Refused {
    /// Something that is not there.
    pub(crate) fn unknown(line: impl Into<String>) -> Refused {
        Refused(StatusCode::NOT_FOUND, line.into())
    }
}

impl From<anyhow::Error> for Refused {
    fn from(error: anyhow::Error) -> Self {
        Refused(StatusCode::INTERNAL_SERVER_ERROR, format!("{error:#}"))
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        (self.0, Json(json!({ "error": self.1 }))).into_response()
    }
}
