//! The starts of episodes: the gripper, and the cubes and goals that a setting allows.

use super::{Fetch, noise};
use environments::fetch::{self, FetchSetting, FetchTask, Ranges};
use std::ops::Range;

#[test]
fn episodes_begin_where_gym_s_do() {
    for (task, grip, goal_height) in [
        (FetchTask::Pick, [1.3419, 0.7491, 0.5347], 0.5747),
        (FetchTask::Push, [1.3455, 0.7490, 0.4186], 0.4247),
    ] {
        let mut fetch = Fetch::open(task, &FetchSetting::default());
        for episode in 0..10 {
            let found = fetch.reset(episode);
            let distance = |index: usize, expected: f32| (found[index] - expected).abs();
            assert!((0..3).all(|axis| distance(axis, grip[axis]) < 1e-6), "{task:?}: {found:?}");
            assert!(distance(5, 0.4247) < 1e-3 && distance(15, goal_height) < 1e-6);
            assert_eq!(found[9..13], [0.0; 4], "{task:?}: closed fingers, an upright cube");
        }
        let start = fetch.reset(0);
        for _ in 0..10 {
            let (rested, _) = fetch.step([0.0; 4]);
            let moved = |numbers: Range<usize>| {
                let pairs = start[numbers.clone()].iter().zip(&rested[numbers]);
                pairs.map(|(before, after)| (before - after).abs()).fold(0.0, f32::max)
            };
            let (tilt, way) = (moved(11..13), moved(0..11).max(moved(13..16)));
            assert!(way < 1e-5, "{task:?}: everything rests, but moves {way} m");
            assert!(tilt < 1e-3, "{task:?}: the cube settles, but tilts by {tilt} rad");
        }
    }
}

#[test]
fn cubes_and_goals_fill_their_ranges_and_nothing_else() {
    let (symmetric, one_sided) = (Ranges::Symmetric, Ranges::OneSided);
    for (task, ranges, cube, goal) in [
        (FetchTask::Pick, symmetric, [0.02, -0.02, 0.02], [0.05, -0.02, 0.02]),
        (FetchTask::Push, symmetric, [0.05, -0.02, 0.02], [0.05, -0.02, 0.02]),
        (FetchTask::Pick, one_sided, [0.05, 0.0, 0.04], [0.05, -0.04, 0.0]),
        (FetchTask::Push, one_sided, [0.05, 0.0, 0.04], [0.05, -0.04, 0.0]),
    ] {
        let setting = FetchSetting { ranges, ..noise(1.5) };
        let mut fetch = Fetch::open(task, &setting);
        let starts: Vec<_> = (0..1_000).map(|episode| fetch.reset(episode)).collect();
        for (place, side, [x, y_min, y_max]) in [(3, 0.1, cube), (13, -0.1, goal)] {
            for (axis, center, least, largest) in
                [(0, 0.0, -x, x), (1, side, y_min, y_max)].map(|(axis, center, least, largest)| {
                    (axis, center, 1.5f32 * least, 1.5f32 * largest)
                })
            {
                let offsets = starts.iter().map(|start| start[place + axis] - start[axis] - center);
                let (low, high) = offsets.fold((f32::MAX, f32::MIN), |(low, high), offset| {
                    (low.min(offset), high.max(offset))
                });
                let slack = 0.01 * (largest - least);
                assert!((low - least).abs() < slack, "{task:?} {ranges:?} {place} {axis}: {low}");
                assert!(
                    (high - largest).abs() < slack,
                    "{task:?} {ranges:?} {place} {axis}: {high}"
                );
            }
        }
    }
}

#[test]
fn a_coverage_keeps_its_bins_of_cubes_and_of_goals() {
    for (coverage, bins) in [(0.25, 4), (0.5, 8), (0.75, 12), (1.0, 16)] {
        let setting = FetchSetting { coverage, ..FetchSetting::default() };
        let mut fetch = Fetch::open(FetchTask::Push, &setting);
        let (mut kept, mut pairs) = ([[false; 16]; 2], [[false; 16]; 16]);
        for episode in 0..4_000 {
            let start = fetch.reset(episode);
            let [cube, goal] = [(3, 0.1), (13, -0.1)].map(|(place, side)| {
                let x = (start[place] - start[0] + 0.05) / 0.1;
                let y = (start[place + 1] - start[1] - side + 0.02) / 0.04;
                4 * (4.0 * x) as usize + (4.0 * y) as usize
            });
            kept[0][cube] = true;
            kept[1][goal] = true;
            pairs[cube][goal] = true;
        }
        let count = |kept: &[bool]| kept.iter().filter(|kept| **kept).count();
        assert_eq!(kept[0], kept[1], "{coverage}: the same bins for both");
        assert_eq!(count(&kept[0]), bins, "{coverage}");
        assert_eq!(count(pairs.as_flattened()), bins * bins, "{coverage}: independent draws");
    }
    let setting = FetchSetting { coverage: 0.3, ..FetchSetting::default() };
    let refusal =
        fetch::Fetch::new(FetchTask::Pick, setting).err().expect("no such coverage").to_string();
    assert!(refusal.contains("0.25, 0.5, 0.75 or 1"), "{refusal}");
}
