//! Readers of foreign bytes: for any input they return a value or one clear line. They do not panic or hang, and
//! their memory is proportional to the input.
//!
//! Method: each reader gets thousands of inputs, slightly damaged valid ones and random bytes (`damage.rs`), drawn
//! from a fixed random stream, so that failures are reproducible. The allocations of its thread are counted, and
//! what it accepts is used as the processes would use it. `GOALWARD_FUZZ_CASES` is the number of inputs per reader.
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

/// Default number of inputs per reader.
const CASES: u32 = 10_000;

/// At least one in this many inputs must be accepted, and one refused.
const LEAST_SHARE: u32 = 50;

/// Longest time for one input. Inputs are a few kilobytes, so only a hang takes this long.
const LONGEST: Duration = Duration::from_secs(30);

/// Longest error line for a refused input, characters.
const LONGEST_LINE: usize = 1_000;

/// Most memory that a reader may hold at once, as a linear function of the input's length.
#[derive(Clone, Copy, Debug)]
struct Memory {
    bytes: u64,
    per_byte: u64,
}

/// A reader under test.
struct Reader<'a> {
    memory: Memory,
    /// Reads an input and uses the result; returns the line for the user if it refuses the input.
    read: &'a dyn Fn(&[u8]) -> Result<(), String>,
}

fn cases() -> u32 {
    match std::env::var("GOALWARD_FUZZ_CASES") {
        Ok(cases) => cases.parse().expect("GOALWARD_FUZZ_CASES is a number"),
        Err(_) => CASES,
    }
}

/// Feeds a reader with inputs made from valid ones; it must accept the valid ones themselves.
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
    // Otherwise the inputs would be too tame, or too wild to get past the first check.
    let (accepted, refused) = (accepted.get(), cases() - accepted.get());
    let least = cases() / LEAST_SHARE;
    assert!(accepted >= least && refused >= least, "{accepted} accepted, {refused} refused");
}

impl Reader<'_> {
    /// Returns whether the input was accepted; fails if the reader exceeds its limits.
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
