//! The state of a process as the kernel reports it (proc_pid_stat(5)), and processor times measured from it.

use std::fs;
use std::time::Duration;

/// The state of a process at one moment, as the kernel reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessStat {
    /// The kernel's letter for its state.
    pub state: char,
    /// Processor time of all its threads so far.
    pub busy: Duration,
    /// Processor time of its child processes that have ended.
    pub ended_children: Duration,
    /// When it was started, as time since the machine booted.
    pub started: Duration,
}

impl ProcessStat {
    /// Reads the state of a process; `None` if there is no such process, or its state cannot be read.
    pub fn of(id: u32) -> Option<ProcessStat> {
        let ticks_per_second = rustix::param::clock_ticks_per_second();
        ProcessStat::parse(&fs::read_to_string(format!("/proc/{id}/stat")).ok()?, ticks_per_second)
    }

    fn parse(line: &str, ticks_per_second: u64) -> Option<ProcessStat> {
        // The second field is the program's name in parentheses. It can contain any character.
        let (_, fields) = line.rsplit_once(") ")?;
        let fields: Vec<&str> = fields.split_whitespace().collect();
        let time = |field: usize| -> Option<Duration> {
            let ticks: u64 = fields.get(field - 3)?.parse().ok()?;
            Some(Duration::from_secs(ticks).div_f64(ticks_per_second as f64))
        };
        Some(ProcessStat {
            state: fields.first()?.chars().next()?,
            busy: time(14)? + time(15)?,
            ended_children: time(16)? + time(17)?,
            started: time(22)?,
        })
    }
}

/// Measures the processor time of this process and its children.
#[derive(Debug, Default)]
pub struct ProcessorClock {
    told: Duration,
}

impl ProcessorClock {
    /// Returns the processor time since the last call, or since the process began, in seconds, to a hundredth.
    pub fn lap(&mut self) -> f64 {
        let now = family_busy().unwrap_or(self.told);
        let lap = now.saturating_sub(self.told);
        self.told = self.told.max(now);
        lap.as_secs_f64()
    }
}

/// Returns the processor time of this process and its children. When a child ends, its time moves
/// from one term of the sum to another.
fn family_busy() -> Option<Duration> {
    let own = ProcessStat::of(std::process::id())?;
    let alive = children().into_iter().filter_map(ProcessStat::of);
    Some(alive.map(|child| child.busy).sum::<Duration>() + own.busy + own.ended_children)
}

/// Returns the living children of all threads of this process.
fn children() -> Vec<u32> {
    let Ok(threads) = fs::read_dir("/proc/self/task") else { return Vec::new() };
    let lists =
        threads.flatten().flat_map(|thread| fs::read_to_string(thread.path().join("children")));
    lists
        .flat_map(|list| list.split_whitespace().flat_map(str::parse).collect::<Vec<_>>())
        .collect()
}

#[cfg(test)]
mod tests {
    use std::process::Command;
    use std::time::Instant;

    use super::*;

    #[test]
    fn the_system_knows_this_process() {
        assert!(matches!(ProcessStat::of(std::process::id()).unwrap().state, 'R' | 'S'));
        assert_eq!(ProcessStat::of(u32::MAX), None);
    }

    #[test]
    fn a_line_of_the_system_is_read() {
        let line = "7 (a) b) c) T 1 7 7 0 -1 4194304 9 0 0 0 150 50 30 70 20 0 3 0 1000 9 9";
        let second = Duration::from_secs(1);
        let stat = ProcessStat {
            state: 'T',
            busy: 2 * second,
            ended_children: second,
            started: 10 * second,
        };
        assert_eq!(ProcessStat::parse(line, 100), Some(stat));
        assert_eq!(ProcessStat::parse("7 (a) T 1", 100), None);
        assert_eq!(ProcessStat::parse("", 100), None);
    }

    #[test]
    fn a_child_counts_while_it_lives_and_when_it_has_ended() {
        let mut clock = ProcessorClock::default();
        clock.lap();
        let mut child = Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap();
        let begun = Instant::now();
        let mut counted = 0.0;
        while counted < 0.5 && begun.elapsed() < Duration::from_secs(30) {
            std::thread::sleep(Duration::from_millis(20));
            counted += clock.lap();
        }
        assert!(counted >= 0.5, "a child at work has added {counted} s");
        let busy = || family_busy().unwrap().as_secs_f64();
        let before = busy();
        child.kill().unwrap();
        child.wait().unwrap();
        let ended = busy() - before;
        assert!((0.0..0.4).contains(&ended), "by its end {counted} s became {ended} s more");
    }
}
