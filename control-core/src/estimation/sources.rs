//! Which samples are let in: each source's clock, range and pulse, before anything is made of its values.
//!
//! | a sample that                                    | is refused as                   |
//! |--------------------------------------------------|---------------------------------|
//! | has a value that is not a number                 | [`SourceFault::NotFinite`]      |
//! | has a value that the part cannot measure         | [`SourceFault::OutOfRange`]     |
//! | is not newer than the one before                 | [`SourceFault::Backwards`]      |
//! | is newer than now by more than a millisecond     | [`SourceFault::FromTheFuture`]  |
//! | is older than the path that is kept              | [`SourceFault::TooLate`]        |
//! | has the bits of the ones before, or half of them | [`SourceFault::Stuck`]          |
//! | is too far from what the others say              | [`SourceFault::Disagrees`]      |
//!
//! A source that says nothing for longer than its [`Source::silence_us_max`] is [`SourceFault::Silent`].
use super::covariance::Observation;
use super::history::DELAY_US_MAX;
use core::fmt;

/// How far clocks may be apart: a time stamp may be after now by this much, µs.
const FUTURE_US: u64 = 1_000;

/// Most numbers of a sample that are compared with those of the one before.
const OFFS: usize = 6;
/// Samples in a row that are off by the same before a source is thought to mean it.
const STEADY: u8 = 5;

/// What measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Gyroscope and accelerometer.
    Inertial,
    /// The second ones, which stand in for the first.
    InertialSecond,
    /// Satellite receiver.
    Gnss,
    /// Barometer.
    Barometer,
    /// The second one, which stands in for the first.
    BarometerSecond,
    /// Magnetometer.
    Magnetometer,
    /// Distance to the ground.
    Range,
    /// Optical flow.
    Flow,
    /// External vision.
    Vision,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Inertial => "inertial unit",
            Self::InertialSecond => "second inertial unit",
            Self::Gnss => "satellite receiver",
            Self::Barometer => "barometer",
            Self::BarometerSecond => "second barometer",
            Self::Magnetometer => "magnetometer",
            Self::Range => "range",
            Self::Flow => "optical flow",
            Self::Vision => "external vision",
        })
    }
}

/// Number of sources.
pub const SOURCES: usize = 9;

impl Source {
    /// Every source, in the order of [`super::EstimatorTelemetry::sources`].
    pub const ALL: [Self; SOURCES] = [
        Self::Inertial,
        Self::InertialSecond,
        Self::Gnss,
        Self::Barometer,
        Self::BarometerSecond,
        Self::Magnetometer,
        Self::Range,
        Self::Flow,
        Self::Vision,
    ];

    /// Silence that is a fault, µs: ten samples of a slow part of the kind; of the inertial unit, what the machine may fly on blindly.
    pub const fn silence_us_max(self) -> u64 {
        match self {
            Self::Inertial | Self::InertialSecond => 15_000,
            Self::Gnss => 1_000_000,
            Self::Barometer | Self::BarometerSecond | Self::Magnetometer | Self::Range => 500_000,
            Self::Flow | Self::Vision => 200_000,
        }
    }

    /// Samples of the same bits that are a fault: more than noise above a step of the converter repeats, and for a range finder, whose
    /// steps are coarse, what it may show on the ground.
    const fn repeats_max(self) -> u16 {
        match self {
            Self::Range => 100,
            _ => 10,
        }
    }
}

/// Why a source is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceFault {
    /// A value is NaN or infinite.
    NotFinite,
    /// A value is beyond what the part can measure, or too poor by its own account.
    OutOfRange,
    /// Its time is not after that of the sample before.
    Backwards,
    /// Its time is after now.
    FromTheFuture,
    /// Its time is before the path that is kept.
    TooLate,
    /// The same bits again and again.
    Stuck,
    /// Its innovation is beyond the gate.
    Disagrees,
    /// Nothing has come from it for too long.
    Silent,
}

impl fmt::Display for SourceFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "a value is not a finite number",
            Self::OutOfRange => "a value is out of range",
            Self::Backwards => "its time stamps do not advance",
            Self::FromTheFuture => "its time stamp is in the future",
            Self::TooLate => "it comes too late",
            Self::Stuck => "it repeats itself to the bit",
            Self::Disagrees => "it disagrees with the other sources",
            Self::Silent => "it says nothing",
        })
    }
}

/// How a source is doing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SourceStatus {
    /// Largest squared innovation of the last sample over that of the gate: beyond 1 it was refused.
    pub ratio: f32,
    /// Time of the last sample that was taken in, µs; 0 if none was.
    pub taken_us: u64,
    /// Samples taken in.
    pub taken: u32,
    /// Samples refused.
    pub refused: u32,
    /// Samples refused since the last one taken in.
    pub refused_in_a_row: u32,
    /// What was wrong with the last sample.
    pub fault: Option<SourceFault>,
}

/// What is remembered of a source.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Watch {
    /// Time of the last sample that had a credible time, µs.
    last_us: u64,
    /// When a sample of any kind last came, µs.
    heard_us: u64,
    fingerprints: [u32; 2],
    repeats: [u16; 2],
    /// How far the last sample was from what was expected, and how many in a row were as far.
    off: [f32; OFFS],
    steady: u8,
    pub(crate) status: SourceStatus,
}

/// Everything about a sample but its meaning.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    pub(crate) time_us: u64,
    /// Made of the bits of each half's values: of a source that is one, the same twice.
    fingerprints: [u32; 2],
    finite: bool,
    in_range: bool,
}

impl Look {
    /// A sample of `values` that are in range if `in_range`.
    pub(crate) fn of<const N: usize>(time_us: u64, values: [f32; N], in_range: bool) -> Self {
        Self { time_us, fingerprints: [fingerprint(&values); 2], finite: are_finite(&values), in_range }
    }

    /// A sample of two halves, each of which can be stuck by itself.
    ///
    /// - `in_range`: not true of what is not a number.
    pub(crate) fn of_halves<const N: usize>(time_us: u64, a: [f32; N], b: [f32; N], in_range: bool) -> Self {
        let fingerprints = [fingerprint(&a), fingerprint(&b)];
        Self { time_us, fingerprints, finite: in_range || are_finite(&a) && are_finite(&b), in_range }
    }
}

fn fingerprint(values: &[f32]) -> u32 {
    values.iter().fold(0_u32, |hash, value| hash.rotate_left(5) ^ value.to_bits())
}

fn are_finite(values: &[f32]) -> bool {
    values.iter().all(|value| value.is_finite())
}

impl Watch {
    /// Nothing heard yet.
    pub(crate) const UNHEARD: Self = Self {
        last_us: 0,
        heard_us: 0,
        fingerprints: [0; 2],
        repeats: [0; 2],
        off: [0.0; OFFS],
        steady: 0,
        status: SourceStatus { ratio: 0.0, taken_us: 0, taken: 0, refused: 0, refused_in_a_row: 0, fault: None },
    };

    /// Whether a sample may be looked at further; else it is counted and named.
    pub(crate) fn admits(&mut self, source: Source, look: &Look, now_us: u64) -> bool {
        self.heard_us = now_us;
        let fault = self.fault_of(source, look, now_us);
        match fault {
            None => true,
            Some(fault) => {
                self.refuse(fault);
                false
            }
        }
    }

    fn fault_of(&mut self, source: Source, look: &Look, now_us: u64) -> Option<SourceFault> {
        if look.time_us > now_us.saturating_add(FUTURE_US) {
            return Some(SourceFault::FromTheFuture);
        }
        if look.time_us <= self.last_us {
            return Some(SourceFault::Backwards);
        }
        self.last_us = look.time_us;
        if !look.finite {
            return Some(SourceFault::NotFinite);
        }
        if !look.in_range {
            return Some(SourceFault::OutOfRange);
        }
        for ((repeats, before), now) in self.repeats.iter_mut().zip(&self.fingerprints).zip(&look.fingerprints) {
            *repeats = if before == now { repeats.saturating_add(1) } else { 0 };
        }
        self.fingerprints = look.fingerprints;
        if self.repeats.iter().any(|repeats| *repeats >= source.repeats_max()) {
            return Some(SourceFault::Stuck);
        }
        (now_us.saturating_sub(look.time_us) > DELAY_US_MAX).then_some(SourceFault::TooLate)
    }

    /// Counts a sample that was not taken in.
    pub(crate) fn refuse(&mut self, fault: SourceFault) {
        self.status.fault = Some(fault);
        self.status.refused = self.status.refused.saturating_add(1);
        self.status.refused_in_a_row = self.status.refused_in_a_row.saturating_add(1);
    }

    /// Counts a sample that was taken in.
    pub(crate) fn take(&mut self, time_us: u64) {
        self.status.taken_us = time_us;
        self.status.taken = self.status.taken.saturating_add(1);
        self.status.refused_in_a_row = 0;
        self.status.fault = None;
    }

    /// Whether the last samples, this one with them, are off from what was expected by the same within the gate: what garbage is not.
    pub(crate) fn is_steady<'a>(
        &mut self,
        observations: impl IntoIterator<Item = &'a Observation>,
        gate_sigma: f32,
    ) -> bool {
        let mut same = true;
        for (off, observation) in self.off.iter_mut().zip(observations) {
            let moved = observation.innovation - *off;
            same &= moved * moved <= gate_sigma * gate_sigma * observation.variance;
            *off = observation.innovation;
        }
        self.steady = if same { self.steady.saturating_add(1) } else { 0 };
        self.steady >= STEADY
    }

    /// Whether it is heard and believed at `now_us`.
    pub(crate) fn is_alive(&self, source: Source, now_us: u64) -> bool {
        self.status.taken > 0 && now_us.saturating_sub(self.status.taken_us) <= source.silence_us_max()
    }

    /// Whether it says anything at `now_us`, to be believed or not.
    pub(crate) fn is_heard(&self, source: Source, now_us: u64) -> bool {
        self.heard_us > 0 && now_us.saturating_sub(self.heard_us) <= source.silence_us_max()
    }

    /// Its status at `now_us`; a source that never spoke has no fault.
    pub(crate) fn status_at(&self, source: Source, now_us: u64) -> SourceStatus {
        let silent = self.heard_us > 0 && !self.is_heard(source, now_us);
        let fault = if silent { Some(SourceFault::Silent) } else { self.status.fault };
        SourceStatus { fault, ..self.status }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW_US: u64 = 10_000_000;

    #[test]
    fn a_sample_is_admitted_or_named() {
        for (why, time_us, value, in_range, want) in [
            ("good", NOW_US - 1000, 1.0, true, None),
            ("as new as can be", NOW_US, 1.0, true, None),
            ("not a number", NOW_US, f32::NAN, true, Some(SourceFault::NotFinite)),
            ("infinite", NOW_US, f32::INFINITY, true, Some(SourceFault::NotFinite)),
            ("out of range", NOW_US, 1.0, false, Some(SourceFault::OutOfRange)),
            ("as old as the last", NOW_US - 600_000, 1.0, true, Some(SourceFault::Backwards)),
            ("as far ahead as clocks may be apart", NOW_US + FUTURE_US, 1.0, true, None),
            ("from the future", NOW_US + FUTURE_US + 1, 1.0, true, Some(SourceFault::FromTheFuture)),
            ("too late", NOW_US - DELAY_US_MAX - 1, 1.0, true, Some(SourceFault::TooLate)),
        ] {
            let mut watch = Watch { last_us: NOW_US - 600_000, ..Watch::UNHEARD };
            assert_eq!(
                watch.admits(Source::Gnss, &Look::of(time_us, [value], in_range), NOW_US),
                want.is_none(),
                "{why}"
            );
            assert_eq!(watch.status.fault, want, "{why}");
            assert_eq!(watch.status.refused, u32::from(want.is_some()), "{why}");
        }
    }

    #[test]
    fn a_sample_from_the_future_does_not_shut_out_the_ones_that_follow() {
        let mut watch = Watch::UNHEARD;
        assert!(!watch.admits(Source::Gnss, &Look::of(u64::MAX, [1.0], true), NOW_US));
        assert!(watch.admits(Source::Gnss, &Look::of(NOW_US, [1.0], true), NOW_US));
    }

    #[test]
    fn a_stuck_source_is_named_and_believed_again_when_it_moves() {
        let mut watch = Watch::UNHEARD;
        let mut admits =
            |i: u64, value: f32| watch.admits(Source::Barometer, &Look::of(i * 1000, [value], true), i * 1000);
        let admitted = (1..=20).filter(|&i| admits(i, 5.0)).count();
        assert_eq!(admitted, 10);
        assert!(admits(21, 5.1));
        assert_eq!(watch.status.refused, 10);
    }

    #[test]
    fn a_source_that_keeps_to_what_it_says_is_told_from_garbage() {
        let mut watch = Watch::UNHEARD;
        let mut steady_after = |offs: &[f32]| {
            offs.iter().fold(false, |_, &off| watch.is_steady(&[Observation::new(off, 1.0, [(0, 1.0)])], 5.0))
        };
        assert!(!steady_after(&[20.0, 21.0, 19.0, 20.5, 20.0]), "four that are like the one before");
        assert!(steady_after(&[19.0]), "five");
        assert!(!steady_after(&[29.0, 30.0]), "it jumps");
        assert!(!steady_after(&[9.0, -40.0, 70.0, 30.0, -5.0, 11.0]), "anything");
    }

    #[test]
    fn silence_is_a_fault_of_those_who_spoke() {
        let mut watch = Watch::UNHEARD;
        assert_eq!(watch.status_at(Source::Gnss, NOW_US).fault, None);
        assert!(watch.admits(Source::Gnss, &Look::of(NOW_US, [1.0], true), NOW_US));
        watch.take(NOW_US);
        assert!(watch.is_alive(Source::Gnss, NOW_US + 900_000));
        assert!(!watch.is_alive(Source::Gnss, NOW_US + 1_100_000));
        assert_eq!(watch.status_at(Source::Gnss, NOW_US + 1_100_000).fault, Some(SourceFault::Silent));
    }
}
