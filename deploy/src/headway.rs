//! Progress of a program that was started for one piece of work, shown from the lines that it prints; see [`Headway`].

use std::io::{self, BufRead, BufReader, Read};
use std::thread::JoinHandle;
use std::time::Instant;

use run::headway::Headway;

use terminal::numbers;
use terminal::status_line::StatusLine;

/// Reads a program's output on a thread of its own: shows the progress that the program reports on `line`, described by
/// `doing`, and returns the rest of the output at the end.
///
/// # Errors
/// When the thread cannot start.
pub(crate) fn follow(
    output: impl Read + Send + 'static,
    doing: &'static str,
    line: StatusLine,
) -> io::Result<JoinHandle<io::Result<Vec<u8>>>> {
    let begun = Instant::now();
    let mut line = line.patient();
    let take_in = move || {
        let mut rest = Vec::new();
        for text in BufReader::new(output).lines() {
            let text = text?;
            match read(&text) {
                Some(headway) => {
                    let words = words(doing, headway, begun.elapsed().as_secs_f64());
                    line.show(&words, 0, false);
                }
                None => rest.extend(text.bytes().chain([b'\n'])),
            }
        }
        line.finish();
        Ok(rest)
    };
    std::thread::Builder::new().name("headway".to_owned()).spawn(take_in)
}

/// Parses a line of progress; `None` if the line is something else.
pub(crate) fn read(line: &str) -> Option<Headway> {
    serde_json::from_str(line).ok()
}

/// Returns the percentage that is done.
pub(crate) fn percent(headway: Headway) -> u64 {
    numbers::percent_done(headway.episodes_done, headway.episodes_wanted)
}

fn words(doing: &str, headway: Headway, elapsed_s: f64) -> String {
    let Headway { episodes_done: done, episodes_wanted: wanted, steps_done } = headway;
    let left_s = elapsed_s * wanted.saturating_sub(done) as f64 / done as f64;
    format!(
        "{doing}: {} of {} episodes  {} %  {}  {} left",
        numbers::count(done),
        numbers::count(wanted),
        percent(headway),
        numbers::rate(steps_done as f64 / elapsed_s),
        numbers::duration(left_s),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_says_how_far_it_is_beside_its_figures() {
        let printed = "{\"episodes_done\":1,\"episodes_wanted\":4,\"steps_done\":9}\n{\"a\":1}\n";
        let line = StatusLine::new();
        let reading = follow(printed.as_bytes(), "evaluating", line).unwrap();
        let rest = reading.join().unwrap().unwrap();
        assert_eq!(rest, b"{\"a\":1}\n");
    }

    #[test]
    fn the_line_has_percent_pace_and_time_left() {
        let headway = Headway { episodes_done: 250, episodes_wanted: 1000, steps_done: 5000 };
        let expected = "evaluating: 250 of 1,000 episodes  25 %  500 steps/s  30 s left";
        assert_eq!(words("evaluating", headway, 10.0), expected);
        let begun = Headway { episodes_done: 0, ..headway };
        assert!(words("evaluating", begun, 10.0).ends_with("  - left"));
        let line = serde_json::to_string(&headway).unwrap();
        assert_eq!(read(&line), Some(headway));
        assert_eq!(read("{\"episodes\": 3}"), None);
    }
}
