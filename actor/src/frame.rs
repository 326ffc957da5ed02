//! Frames between the side that acts and the process that holds the environments: between an actor and its Python
//! process (`python/child.py` is the other end), and between any program and an actor that serves a task to it.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};

use protocol::task::{ActionSpec, ObservationSpec};
use serde::{Deserialize, Serialize};

/// Bytes before a frame's body: the length of the body, and the kind of the frame.
const HEAD_BYTES: usize = 5;

/// Longest body in bytes; a turn of many lanes is far shorter.
const LONGEST_BODY: usize = 64 << 20;

/// Bytes of a slot's request before its action.
const REQUEST_BYTES: usize = 16;

/// Bytes of a slot's answer before its observation.
const ANSWER_BYTES: usize = 8;

/// Begin an episode.
const RESET: u8 = 0;

/// Begin one in a new environment.
const REBUILD: u8 = 1;

/// Take an action.
const STEP: u8 = 2;

/// The kind of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// What the environment is, in JSON.
    Hello = 1,
    /// Requests to slots, or their answers.
    Turn = 2,
    /// Why there is no answer, in JSON.
    Failed = 3,
    /// The slot whose expert is asked, or the action that the expert takes.
    Expert = 4,
    /// The slot whose state is to be rendered, or the picture as a PNG file; empty if there is none.
    Picture = 5,
}

/// The description of an environment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Hello {
    pub(crate) observation: ObservationSpec,
    pub(crate) action: ActionSpec,
    /// Longest episode in steps, if the environment has a limit.
    pub(crate) horizon_steps: Option<u32>,
    /// Labels of the numbers of an observation; empty for cells.
    pub(crate) labels: Vec<String>,
    /// Parts of the observation that are left out, because they are text.
    pub(crate) dropped: Vec<String>,
    /// The rule that tells success.
    pub(crate) success: String,
    /// Versions of Python and of the packages that decide what the environment does.
    pub(crate) versions: BTreeMap<String, String>,
    /// SHA-256 of the files of modules that decide this too and belong to no installed package.
    pub(crate) sources: BTreeMap<String, String>,
}

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Failure {
    pub(crate) slot: u16,
    /// `start`, `reset`, `step`, `expert` or `render`.
    pub(crate) during: String,
    pub(crate) error: String,
    pub(crate) traceback: String,
}

/// A request to a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Request<'a> {
    /// Begin an episode with this seed; in a new environment if `rebuild`.
    Reset { seed: u32, rebuild: bool },
    /// Take an action.
    Step(&'a [u8]),
}

/// A slot's answer to a request.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Answer {
    pub(crate) terminated: bool,
    pub(crate) truncated: bool,
    pub(crate) success: bool,
    pub(crate) reward: f32,
    pub(crate) observation: Vec<u8>,
}

/// Appends a slot's request to the body of a turn.
pub(crate) fn append(slot: u16, request: Request<'_>, action_bytes: usize, body: &mut Vec<u8>) {
    let (op, seed, action): (u8, u64, &[u8]) = match request {
        Request::Reset { seed, rebuild } => {
            (if rebuild { REBUILD } else { RESET }, u64::from(seed), &[])
        }
        Request::Step(action) => (STEP, 0, action),
    };
    let end = body.len() + REQUEST_BYTES + action_bytes;
    body.extend(slot.to_le_bytes());
    body.extend([op, 0, 0, 0, 0, 0]);
    body.extend(seed.to_le_bytes());
    body.extend(action);
    body.resize(end, 0);
}

/// Returns the answers of a turn's slots, in order.
pub(crate) fn answers(
    body: &[u8],
    observation_bytes: usize,
) -> impl Iterator<Item = (u16, Answer)> + '_ {
    body.chunks_exact(ANSWER_BYTES + observation_bytes).map(|bytes| {
        let (head, observation) = bytes.split_at(ANSWER_BYTES);
        let flag = |bit: u8| head[2] & bit != 0;
        let answer = Answer {
            terminated: flag(1),
            truncated: flag(2),
            success: flag(4),
            reward: f32::from_le_bytes([head[4], head[5], head[6], head[7]]),
            observation: observation.to_vec(),
        };
        (u16::from_le_bytes([head[0], head[1]]), answer)
    })
}

/// Returns the requests of a turn's slots, in order.
pub(crate) fn requests(
    body: &[u8],
    action_bytes: usize,
) -> impl Iterator<Item = (u16, Request<'_>)> {
    body.chunks_exact(REQUEST_BYTES + action_bytes).map(|bytes| {
        let (head, action) = bytes.split_at(REQUEST_BYTES);
        let seed = u32::from_le_bytes([head[8], head[9], head[10], head[11]]);
        let request = match head[2] {
            STEP => Request::Step(action),
            op => Request::Reset { seed, rebuild: op == REBUILD },
        };
        (u16::from_le_bytes([head[0], head[1]]), request)
    })
}

/// Appends a slot's answer to the body of a turn.
pub(crate) fn append_answer(slot: u16, answer: &Answer, body: &mut Vec<u8>) {
    let flags = [answer.terminated, answer.truncated, answer.success];
    let flags = flags.iter().rev().fold(0, |flags, flag| 2 * flags + u8::from(*flag));
    body.extend(slot.to_le_bytes());
    body.extend([flags, 0]);
    body.extend(answer.reward.to_le_bytes());
    body.extend(&answer.observation);
}

/// Writes a frame.
///
/// # Errors
/// When the other end is gone.
pub(crate) fn write(link: &mut impl Write, kind: Kind, body: &[u8]) -> io::Result<()> {
    let length = u32::try_from(body.len()).map_err(io::Error::other)?;
    let mut frame = Vec::with_capacity(HEAD_BYTES + body.len());
    frame.extend(length.to_le_bytes());
    frame.push(kind as u8);
    frame.extend(body);
    link.write_all(&frame)
}

/// Reads a frame.
///
/// # Errors
/// When the other end is gone or silent, or what arrives is not a frame.
pub(crate) fn read(link: &mut impl Read) -> io::Result<(Kind, Vec<u8>)> {
    let mut head = [0; HEAD_BYTES];
    link.read_exact(&mut head)?;
    let length = u32::from_le_bytes([head[0], head[1], head[2], head[3]]) as usize;
    let kind = match head[4] {
        1 => Kind::Hello,
        2 => Kind::Turn,
        3 => Kind::Failed,
        4 => Kind::Expert,
        5 => Kind::Picture,
        other => return Err(io::Error::other(format!("expected a frame, found kind {other}"))),
    };
    if length > LONGEST_BODY {
        return Err(io::Error::other(format!(
            "expected a frame of at most {LONGEST_BODY} bytes, found {length}"
        )));
    }
    let mut body = vec![0; length];
    link.read_exact(&mut body)?;
    Ok((kind, body))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_read_as_it_was_written() {
        let mut link = Vec::new();
        write(&mut link, Kind::Turn, &[1, 2, 3]).unwrap();
        assert_eq!(link, [3, 0, 0, 0, 2, 1, 2, 3]);
        assert_eq!(read(&mut &*link).unwrap(), (Kind::Turn, vec![1, 2, 3]));
        assert!(read(&mut &link[..6]).is_err(), "cut off");
        assert!(read(&mut &[0, 0, 0, 0, 9][..]).is_err(), "no kind");
        assert!(read(&mut &[255, 255, 255, 255, 2][..]).is_err(), "too long");
    }

    #[test]
    fn requests_have_one_length_and_answers_name_their_slots() {
        let mut body = Vec::new();
        append(3, Request::Reset { seed: 7, rebuild: true }, 4, &mut body);
        append(258, Request::Step(&[1, 2, 3, 4]), 4, &mut body);
        assert_eq!(body.len(), 2 * (REQUEST_BYTES + 4));
        assert_eq!(body[..12], [3, 0, 1, 0, 0, 0, 0, 0, 7, 0, 0, 0]);
        assert_eq!(body[20..23], [2, 1, 2]);
        assert_eq!(body[36..], [1, 2, 3, 4]);
        let requests: Vec<_> = requests(&body, 4).collect();
        let reset = Request::Reset { seed: 7, rebuild: true };
        assert_eq!(requests, [(3, reset), (258, Request::Step(&[1, 2, 3, 4]))]);
        let bytes = [&[2, 1, 5, 0][..], &0.5_f32.to_le_bytes(), &[8, 9]].concat();
        let expected = Answer {
            terminated: true,
            truncated: false,
            success: true,
            reward: 0.5,
            observation: vec![8, 9],
        };
        let mut appended = Vec::new();
        append_answer(258, &expected, &mut appended);
        assert_eq!(appended, bytes);
        assert_eq!(answers(&bytes, 2).collect::<Vec<_>>(), [(258, expected)]);
    }
}
