//! What the desk knows of each actor: when it last asked or sent something, and how fast it acts.

use std::collections::BTreeMap;
use std::time::Instant;

use protocol::messages::ActorHeard;

use crate::ledger::LeaseLedger;

/// The actors heard from, by their names on the bus.
#[derive(Debug, Default)]
pub(super) struct Heard(BTreeMap<String, Actor>);

#[derive(Debug)]
struct Actor {
    first: Instant,
    last: Instant,
    /// Environment steps in its trajectories, not counting copies.
    steps: u64,
}

impl Heard {
    /// Notes that `actor` asked for something, or delivered `steps` new environment steps.
    pub(super) fn note(&mut self, actor: &str, steps: u64) {
        let now = Instant::now();
        let new = || Actor { first: now, last: now, steps: 0 };
        let found = self.0.entry(actor.to_owned()).or_insert_with(new);
        found.last = now;
        found.steps += steps;
    }

    /// Forgets all actors that are not among `alive`.
    pub(super) fn keep(&mut self, alive: &[String]) {
        self.0.retain(|actor, _| alive.contains(actor));
    }

    pub(super) fn told(&self, ledger: Option<&LeaseLedger>) -> Vec<ActorHeard> {
        let told = |(name, actor): (&String, &Actor)| ActorHeard {
            name: name.clone(),
            leases: ledger.map_or(0, |ledger| ledger.held_by(name)) as u32,
            ago_s: actor.last.elapsed().as_secs_f64(),
            steps_per_s: actor.steps as f64 / actor.first.elapsed().as_secs_f64(),
        };
        self.0.iter().map(told).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn the_rate_counts_from_the_first_word() {
        let mut heard = Heard::default();
        heard.note("actor-0-7", 0);
        heard.note("actor-1-8", 0);
        std::thread::sleep(Duration::from_millis(20));
        heard.note("actor-0-7", 100);
        let told = heard.told(None);
        assert!(told[0].steps_per_s > 0.0 && told[0].steps_per_s <= 5_000.0, "{told:?}");
        assert!(told[0].ago_s < told[1].ago_s && told[1].steps_per_s == 0.0, "{told:?}");
        heard.keep(&["actor-1-8".to_owned()]);
        assert_eq!(heard.told(None).len(), 1);
    }
}
