//! What faults do to one sensor's readings.
//!
//! ```text
//! truth and errors ─► bias, drift, spikes ─► stuck, garbage ─► delayed ─► register ─► off, intermittent ─► line
//! ```
use super::chance::Chance;
use crate::fault::sensors::{Sensor, SensorAxis, SensorFault, SensorFaultKind};
use crate::fault::{Intermittent, Profile, Toggle};
use crate::flight::{Stream, random_of};
use nalgebra::Vector3;
use std::collections::VecDeque;

/// What a sensor reads, as faults see it.
pub(super) trait Reading: Copy {
    /// Its numbers, in the order of the axes.
    fn channels(&mut self) -> &mut [f64];

    /// These, and after them those in another unit, which only what decides the whole reading changes.
    fn everything(&mut self) -> &mut [f64] {
        self.channels()
    }
}

impl<const N: usize> Reading for [f64; N] {
    fn channels(&mut self) -> &mut [f64] {
        self
    }
}

impl Reading for Vector3<f64> {
    fn channels(&mut self) -> &mut [f64] {
        self.as_mut_slice()
    }
}

/// A fault and where it stands.
struct Occurrence<R> {
    fault: SensorFault,
    chance: Chance,
    /// Whether a fault of an intermittent profile is there.
    drawn: Toggle,
    level: f64,
    /// Until when it has been followed, s.
    until_s: f64,
    drifted: f64,
    /// What it read at the onset.
    stuck: Option<R>,
}

impl<R: Reading> Occurrence<R> {
    /// Brings it to `t_s`; gives the time since it was last asked, s.
    fn advance(&mut self, t_s: f64) -> f64 {
        let Self { fault, chance, drawn, .. } = self;
        if let (true, Profile::Intermittent(Intermittent { on_mean_s, off_mean_s })) =
            (fault.is_active(t_s), fault.profile)
        {
            drawn.advance(t_s, |on| chance.wait_s(if on { on_mean_s } else { off_mean_s }));
        }
        self.level = fault.level(t_s, drawn.on);
        let since_s = t_s - self.until_s.max(fault.from_s);
        self.until_s = t_s;
        if self.level == 0.0 {
            self.stuck = None;
        }
        since_s
    }

    /// Changes those of `channels` that it is on.
    fn change(&self, channels: &mut [f64], mut change: impl FnMut(usize, &mut f64)) {
        let axis = self.fault.axis.map(SensorAxis::index);
        for (i, channel) in channels.iter_mut().enumerate() {
            if axis.is_none_or(|axis| axis == i) {
                change(i, channel);
            }
        }
    }
}

/// The faults of one sensor, in the order of the file.
pub(super) struct Broken<R> {
    faults: Vec<Occurrence<R>>,
    /// Readings of the last while, oldest first, with their times.
    past: VecDeque<(f64, R)>,
    /// How long that while is, s.
    memory_s: f64,
}

impl<R: Reading> Broken<R> {
    /// The faults of unit `unit` of `sensor` among `faults`, each with random numbers of its own.
    pub(super) fn new(faults: &[SensorFault], sensor: Sensor, unit: u8, seed: u64) -> Self {
        let own = faults.iter().enumerate().filter(|(_, fault)| fault.sensor == sensor && fault.unit == unit);
        let faults: Vec<_> = own
            .map(|(i, &fault)| Occurrence {
                fault,
                chance: Chance(random_of(seed, Stream::SensorFault, i as u8)),
                drawn: Toggle::off_until(fault.from_s),
                level: 0.0,
                until_s: 0.0,
                drifted: 0.0,
                stuck: None,
            })
            .collect();
        let memory_s = faults.iter().map(|fault| match fault.fault.kind {
            SensorFaultKind::Delayed { delay_s } => delay_s,
            _ => 0.0,
        });
        Self { memory_s: memory_s.sum(), faults, past: VecDeque::new() }
    }

    /// What is read at `t_s` instead of `reading`.
    ///
    /// - `span`: smallest and largest reading of each channel.
    pub(super) fn read(&mut self, t_s: f64, mut reading: R, span: impl Fn(usize) -> (f64, f64)) -> R {
        let mut delay_s = 0.0;
        for fault in &mut self.faults {
            let since_s = fault.advance(t_s);
            let level = fault.level;
            match fault.fault.kind {
                SensorFaultKind::Bias { offset } => fault.change(reading.channels(), |_, x| *x += offset * level),
                SensorFaultKind::Drift { rate } => {
                    // What has drifted goes with the fault.
                    let there = fault.fault.is_active(t_s);
                    fault.drifted = if there { fault.drifted + rate * level * since_s } else { 0.0 };
                    fault.change(reading.channels(), |_, x| *x += fault.drifted);
                }
                SensorFaultKind::Spikes { size, rate_1_s } => {
                    let (met, up) = (fault.chance.even(), fault.chance.even() < 0.5);
                    if met < 1.0 - libm::exp(-rate_1_s * level * since_s) {
                        fault.change(reading.channels(), |_, x| *x += if up { size } else { -size });
                    }
                }
                SensorFaultKind::Delayed { delay_s: most_s } => delay_s += most_s * level,
                SensorFaultKind::Stuck if level > 0.0 => {
                    let mut stuck = *fault.stuck.get_or_insert(reading);
                    match fault.fault.axis {
                        None => reading = stuck,
                        Some(_) => fault.change(reading.channels(), |i, x| *x = stuck.channels()[i]),
                    }
                }
                SensorFaultKind::Garbage if level > 0.0 => {
                    let draws: Vec<f64> = reading.everything().iter().map(|_| fault.chance.even()).collect();
                    fault.change(reading.everything(), |i, x| {
                        let (low, high) = span(i);
                        *x = low + (high - low) * draws[i];
                    });
                }
                _ => {}
            }
        }
        self.recall(t_s, delay_s, reading)
    }

    /// The reading of `delay_s` ago, or the oldest there is.
    fn recall(&mut self, t_s: f64, delay_s: f64, reading: R) -> R {
        if self.memory_s == 0.0 {
            return reading;
        }
        self.past.push_back((t_s, reading));
        // The one just before the while begins stays.
        while self.past.get(1).is_some_and(|&(then_s, _)| then_s <= t_s - self.memory_s) {
            self.past.pop_front();
        }
        let old = self.past.iter().rev().find(|&&(then_s, _)| then_s <= t_s - delay_s + 1e-7);
        old.or(self.past.front()).map_or(reading, |&(_, old)| old)
    }

    /// Whether the sample of now is lost; asked once a sample, after [`Self::read`].
    pub(super) fn is_lost(&mut self) -> bool {
        self.faults.iter_mut().fold(false, |lost, fault| {
            lost | match fault.fault.kind {
                SensorFaultKind::Off => fault.level > 0.0,
                SensorFaultKind::Intermittent { loss } => fault.chance.even() < loss * fault.level,
                _ => false,
            }
        })
    }
}
