//! Readers of foreign bytes: whatever they are given, they give a value or one clear line. They do
//! not panic, do not hang, and take memory in proportion to what they are given.
//!
//! Method: each reader gets thousands of inputs, whole ones damaged a little and bytes of no origin
//! (`damage.rs`), drawn from a fixed stream, so that a failure comes again. What it allocates is
//! counted on its thread, and what it accepts is used as the processes would use it.
//! `GOALWARD_FUZZ_CASES` is the number of inputs per reader.
#![allow(clippy::unwrap_used, reason = "a test ends at the first surprise")]

mod bus;
mod checkpoints;
mod damage;
mod log;
mod texts;
mod whole;

use std::cell::Cell;
use std::time::{Duration, Instant};

use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};

/// Inputs per reader where nothing else is asked for.
const CASES: u32 = 10_000;

/// One in so many inputs at least is accepted, and one refused.
const LEAST_SHARE: u32 = 50;

/// Longest time for one input. An input is a few kilobytes; only a hang takes so long.
const LONGEST: Duration = Duration::from_secs(30);

/// Longest line about an input that is refused, characters.
const LONGEST_LINE: usize = 1_000;

/// Memory that a reader may have at once, as a line over the input's length.
#[derive(Clone, Copy, Debug)]
struct Memory {
    bytes: u64,
    per_byte: u64,
}

/// A reader under test.
struct Reader<'a> {
    memory: Memory,
    /// Reads an input and uses what it has read; else the line for the user.
    read: &'a dyn Fn(&[u8]) -> Result<(), String>,
}

fn cases() -> u32 {
    match std::env::var("GOALWARD_FUZZ_CASES") {
        Ok(cases) => cases.parse().expect("GOALWARD_FUZZ_CASES is a number"),
        Err(_) => CASES,
    }
}

/// Gives a reader inputs made from whole ones, which it must accept.
fn fuzz(whole: Vec<Vec<u8>>, reader: &Reader<'_>) {
    for bytes in &whole {
        (reader.read)(bytes).expect("a whole input is accepted");
    }
    let config = Config {
        cases: cases(),
        failure_persistence: None,
        max_shrink_iters: 2_000,
        ..Config::default()
    };
    let stream = TestRng::deterministic_rng(RngAlgorithm::ChaCha);
    let mut runner = TestRunner::new_with_rng(config, stream);
    let accepted = Cell::new(0);
    let tried = runner.run(&damage::inputs(whole), |bytes| {
        accepted.set(accepted.get() + u32::from(reader.survives(&bytes)?));
        Ok(())
    });
    if let Err(failure) = tried {
        panic!("{failure}");
    }
    // Else the inputs would be too tame, or too wild, to reach what lies behind the first check.
    let (accepted, refused) = (accepted.get(), cases() - accepted.get());
    let least = cases() / LEAST_SHARE;
    assert!(accepted >= least && refused >= least, "{accepted} accepted, {refused} refused");
}

impl Reader<'_> {
    /// Whether the input was accepted; fails when the reader does not keep its promises.
    fn survives(&self, bytes: &[u8]) -> Result<bool, TestCaseError> {
        let begun = Instant::now();
        let mut outcome = Ok(());
        let allocated = allocation_counter::measure(|| outcome = (self.read)(bytes));
        let expect = |holds: bool, what: String| {
            if holds { Ok(()) } else { Err(TestCaseError::fail(what)) }
        };
        let Memory { bytes: constant, per_byte } = self.memory;
        let most = constant + per_byte * bytes.len() as u64;
        let found = allocated.bytes_max;
        expect(found <= most, format!("expected at most {most} bytes of memory, found {found}"))?;
        let elapsed = begun.elapsed();
        expect(elapsed < LONGEST, format!("it took {elapsed:?}"))?;
        if let Err(line) = &outcome {
            let is_line = !line.is_empty()
                && line.chars().count() <= LONGEST_LINE
                && !line.chars().any(char::is_control);
            expect(is_line, format!("expected one clear line, found {line:?}"))?;
        }
        Ok(outcome.is_ok())
    }
}
