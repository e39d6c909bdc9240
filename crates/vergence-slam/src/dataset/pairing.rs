//! Which pictures of several cameras are of one instant, and where a recording has holes.

use vergence_time::{Span, Timestamp};

use super::Dataset;

/// How far apart pictures of one instant may be at most: whoever asks for more has another reason than clocks that differ.
pub const MOST_APART: Span = Span::from_millis(100);

/// What comes of pairing.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Paired {
    /// For each frame the number of each camera's picture.
    pub(super) frames: Vec<Vec<usize>>,
    /// Of pictures of the first camera without a partner: how far away the nearest one is in the middle; positive where it is later.
    pub(super) apart: Option<Span>,
}

/// Frames at the first camera's times for which all cameras have a picture within `within`; each picture is used once.
pub(super) fn pair(times: &[Vec<Timestamp>], within: Span) -> Paired {
    let Some((first, others)) = times.split_first() else { return Paired::default() };
    let mut paired = Paired::default();
    let mut apart: Vec<i64> = Vec::new();
    let mut free = vec![0; others.len()];
    for (number, at) in first.iter().enumerate() {
        let off = |time: &Timestamp| time.as_nanos().saturating_sub(at.as_nanos());
        let mut frame = vec![number];
        let mut farthest = 0i64;
        for (table, free) in others.iter().zip(&free) {
            let after = table.partition_point(|time| time < at);
            let near = (after.saturating_sub(1)..table.len().min(after + 1)).filter(|index| index >= free);
            let Some(near) = near.min_by_key(|index| off(&table[*index]).unsigned_abs()) else { break };
            let off = off(&table[near]);
            farthest = if off.unsigned_abs() > farthest.unsigned_abs() { off } else { farthest };
            frame.push(near);
        }
        if frame.len() == times.len() && farthest.unsigned_abs() <= within.as_nanos().unsigned_abs() {
            for (free, used) in free.iter_mut().zip(&frame[1..]) {
                *free = used + 1;
            }
            paired.frames.push(frame);
        } else if frame.len() == times.len() {
            apart.push(farthest);
        }
    }
    let middle = apart.len() / 2;
    paired.apart = (!apart.is_empty()).then(|| Span::from_nanos(*apart.select_nth_unstable(middle).1));
    paired
}

/// How far apart, in words.
pub(super) fn milliseconds(span: Span) -> String {
    format!("{:.3} ms", span.as_millis_f64().abs())
}

/// Where so many periods (the median of all) pass without anything: after which time, and for how long. `times` grow.
pub fn holes(times: impl Iterator<Item = Timestamp> + Clone) -> Vec<(Timestamp, Span)> {
    const PERIODS: i64 = 5;
    let steps = || {
        let later = times.clone().skip(1);
        times.clone().zip(later).filter_map(|(a, b)| Some((a, b.since(a)?)))
    };
    let mut all: Vec<i64> = steps().map(|step| step.1.as_nanos()).collect();
    if all.is_empty() {
        return Vec::new();
    }
    let middle = all.len() / 2;
    let longest = all.select_nth_unstable(middle).1.saturating_mul(PERIODS);
    steps().filter(|step| step.1.as_nanos() > longest).collect()
}

/// Such holes in a sentence, with times since `begins`; `None` where there are none.
pub fn say_holes(what: &str, holes: &[(Timestamp, Span)], begins: Timestamp) -> Option<String> {
    const SHOWN: usize = 4;
    let longest = holes.iter().max_by_key(|hole| hole.1)?;
    let one = |(after, span): &(Timestamp, Span)| {
        let after = after.since(begins).map_or(0.0, Span::as_secs_f64);
        format!("{:.3} s after {after:.3} s", span.as_secs_f64())
    };
    let mut all: Vec<String> = holes.iter().take(SHOWN).map(one).collect();
    if holes.len() > SHOWN {
        all.push(format!("and {} more, the longest {}", holes.len() - SHOWN, one(longest)));
    }
    Some(format!("no {what} for {} (more than five periods)", all.join(", ")))
}

impl Dataset {
    /// What of the recording is left out, and where it has holes, in sentences; of the readings only where they take part.
    pub fn doubts(&self, inertial: bool) -> Vec<String> {
        let mut all = Vec::new();
        let frames = self.frames.len();
        let begins = self.frames.first().map_or(Timestamp::default(), |frame| frame.at);
        let alone: Vec<String> = self
            .pictures
            .iter()
            .enumerate()
            .filter(|(_, count)| **count > frames)
            .map(|(camera, count)| format!("{} of {count} pictures of cam{camera}", count - frames))
            .collect();
        if !alone.is_empty() {
            let mut said = format!(
                "{} have no partner within {} in every other camera: left out",
                alone.join(", "),
                milliseconds(self.pair_within)
            );
            if let Some(apart) = self.apart {
                said += &format!("; the nearest is {} away in the middle", milliseconds(apart));
                // What is farther off is another exposure.
                let exposure = self.period().map_or(0, |period| period.as_nanos() / 4);
                if apart.as_nanos().abs() < exposure {
                    said += "; where that is one instant to you, a longer pair_within_ms takes them together";
                }
            }
            all.push(said);
        }
        all.extend(say_holes("pictures", &holes(self.frames.iter().map(|frame| frame.at)), begins));
        if let Some(unit) = self.inertial.as_ref().filter(|_| inertial) {
            all.extend(say_holes("readings", &holes(unit.samples.iter().map(|sample| sample.0)), begins));
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn every(millis: i64, shift_us: i64, count: i64) -> Vec<Timestamp> {
        (0..count).map(|k| Timestamp::from_nanos(k * millis * 1_000_000 + shift_us * 1000)).collect()
    }

    #[test]
    fn partners_are_the_nearest_and_no_picture_is_used_twice() {
        let paired = pair(&[every(50, 0, 10), every(50, 800, 10)], Span::from_millis(1));
        assert_eq!((paired.frames.len(), paired.apart), (10, None));
        // Every second picture of the second camera is missing.
        let paired = pair(&[every(50, 0, 10), every(100, 0, 5)], Span::from_millis(1));
        assert_eq!(paired.frames, (0..5).map(|k| vec![2 * k, k]).collect::<Vec<_>>());
        assert_eq!(paired.apart.map(|apart| apart.as_nanos().abs()), Some(50_000_000));
        // Three milliseconds later: too far, unless that is said to be near.
        let late = [every(50, 0, 10), every(50, 3000, 10)];
        let paired = pair(&late, Span::from_millis(1));
        assert_eq!((paired.frames.len(), paired.apart), (0, Some(Span::from_millis(3))));
        assert_eq!(pair(&late, Span::from_millis(5)).frames.len(), 10);
        // However far may be: each picture once.
        let paired = pair(&[every(10, 0, 30), every(50, 0, 6)], Span::from_millis(100));
        let used: Vec<usize> = paired.frames.iter().map(|frame| frame[1]).collect();
        assert!(used.windows(2).all(|two| two[0] < two[1]), "{used:?}");
        assert_eq!(pair(&[], MOST_APART), Paired::default());
        assert_eq!(pair(&[every(50, 0, 3), Vec::new()], MOST_APART), Paired::default());
    }

    #[test]
    fn holes_have_their_times() {
        let mut times = every(50, 0, 100);
        assert!(holes(times.iter().copied()).is_empty());
        times.drain(40..50);
        times.drain(60..63);
        let found = holes(times.iter().copied());
        assert_eq!(found, [(Timestamp::from_nanos(1_950_000_000), Span::from_millis(550))]);
        let said = say_holes("readings", &found, times[0]).expect("a hole");
        assert_eq!(said, "no readings for 0.550 s after 1.950 s (more than five periods)");
        let many: Vec<_> =
            (0..9).map(|k| (Timestamp::from_nanos(k * 1_000_000_000), Span::from_millis(300 + k))).collect();
        let said = say_holes("pictures", &many, Timestamp::default()).expect("holes");
        assert!(
            said.contains("0.303 s after 3.000 s, and 5 more, the longest 0.308 s after 8.000 s"),
            "{said}"
        );
        assert_eq!(say_holes("pictures", &[], Timestamp::default()), None);
        assert!(holes(std::iter::empty()).is_empty());
    }

    proptest! {
        #[test]
        fn pairs_are_within_what_was_asked(
            steps in prop::collection::vec((1..200i64, 1..200i64), 1..40), within in 0..100i64,
        ) {
            let times = |pick: fn(&(i64, i64)) -> i64| {
                let mut at = 0;
                steps.iter().map(|step| { at += pick(step); Timestamp::from_nanos(at * 1_000_000) }).collect::<Vec<_>>()
            };
            let tables = [times(|step| step.0), times(|step| step.1)];
            let paired = pair(&tables, Span::from_millis(within));
            for frame in &paired.frames {
                let off = tables[0][frame[0]].as_nanos() - tables[1][frame[1]].as_nanos();
                prop_assert!(off.abs() <= within * 1_000_000);
            }
            prop_assert!(paired.frames.windows(2).all(|two| two[0][1] < two[1][1]));
        }
    }
}
