//! What a reader of a comparison should not miss, each with its number.
use super::{Comparison, Entry, short};
use crate::controllers::ControllerName;
use crate::fault::{Fault, Rotors, in_words};
use crate::limits::{Heading, Hover, Thrusts, hover, loss_max, thrusts_under, together, torque_nm};
use crate::metrics::{Account, Flown};
use crate::plant::PlantKind;
use crate::reference::Reference;
use crate::vehicle::Vehicle;

/// Half a peak-to-peak that is called a limit cycle, m: far above what the sensors' noise makes.
const LIMIT_CYCLE_M: f64 = 0.03;
/// A share of the time that is worth a word.
const NOTABLE: f64 = 0.005;
/// Torque that holds nothing, N m.
const NO_TORQUE_NM: f64 = 1e-6;

/// A share as people read it.
fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// A length as people read it.
pub(super) fn length(m: f64) -> String {
    if m < 1.0 { format!("{:.1} mm", 1000.0 * m) } else { format!("{m:.2} m") }
}

impl Entry {
    /// The mean of a share over the flights that are `meant`.
    fn mean(&self, meant: fn(&Flown) -> bool, of: fn(&Account) -> Option<f64>) -> f64 {
        let shares: Vec<_> = self.flights.iter().filter(|x| meant(x)).filter_map(|x| of(&x.account)).collect();
        shares.iter().sum::<f64>() / shares.len().max(1) as f64
    }

    /// What the flights that `ended` before their time had in common: what was refused, and whether heading was given up.
    fn strain(&self, ended: fn(&Flown) -> bool) -> String {
        let said: Vec<_> = [
            ("thrust was refused", self.mean(ended, |account| account.thrust_refused_share)),
            ("roll or pitch was refused", self.mean(ended, |account| account.tilting_refused_share)),
            ("heading was given up", self.mean(ended, |account| account.heading_given_up_share)),
        ]
        .into_iter()
        .filter(|(_, share)| *share >= NOTABLE)
        .map(|(what, share)| format!("{what} for {:.0} %", 100.0 * share))
        .collect();
        if said.is_empty() {
            return String::new();
        }
        format!(" From the onset on {} of the time.", said.join(", "))
    }

    fn crash(&self) -> Option<String> {
        let crashed = self.flights.iter().filter_map(|flown| flown.crash);
        let first = crashed.min_by(|a, b| a.t_s.total_cmp(&b.t_s))?;
        Some(format!(
            "{} crashed in {} of {} flights: it {}, first at {} s.{}",
            self.controller,
            self.crashed(),
            self.flights.len(),
            first.cause,
            short(first.t_s),
            self.strain(|flown| flown.crash.is_some())
        ))
    }

    fn landing(&self) -> Option<String> {
        let landed = self.flights.iter().filter_map(|flown| flown.landing);
        let worst = landed.max_by(|a, b| a.touchdown.speed_m_s.total_cmp(&b.touchdown.speed_m_s))?;
        Some(format!(
            "{} came down in {} of {} flights, at worst {}, {} s into the flight.{}",
            self.controller,
            self.came_down(),
            self.flights.len(),
            worst.touchdown,
            short(worst.t_s),
            self.strain(|flown| flown.landing.is_some())
        ))
    }

    /// Those that were led down, and why.
    fn led_down(&self) -> Option<String> {
        let led: Vec<_> = self.flights.iter().filter_map(|flown| flown.account.led_down).collect();
        let latest = led.iter().max_by(|a, b| a.delay_s.total_cmp(&b.delay_s))?;
        let (one, other) = (latest.rotor + 1, latest.rotor + 3);
        Some(format!(
            "{} led the machine down in {} of {} flights: rotors {one} and {other} were known to be gone at the latest {:.0} ms after the \
             onset, and on the two others, which turn the same way, the body spins ever faster.",
            self.controller,
            led.len(),
            self.flights.len(),
            1000.0 * latest.delay_s
        ))
    }

    fn refusal(&self) -> Option<String> {
        let first = self.flights.iter().find_map(|flown| flown.refusal)?;
        let (refused, flights) = (self.refused(), self.flights.len());
        Some(format!("{} never took off in {refused} of {flights} flights: {}.", self.controller, first.fault))
    }

    /// Those that stayed up by spinning.
    fn spin(&self) -> Option<String> {
        let given_up = self.mean(Flown::survived, |account| account.heading_given_up_share);
        let (_, worst) = self.metric("yaw_rate_max_rad_s").filter(|_| given_up >= NOTABLE)?;
        Some(format!(
            "{} survived {} of {} flights with heading given up for {:.0} % of the time from the onset on, turning at up to {} rad/s.",
            self.controller,
            self.survived(),
            self.flights.len(),
            100.0 * given_up,
            short(worst)
        ))
    }

    fn limit_cycle(&self) -> Option<String> {
        let (median, _) = self.metric("lateral_limit_cycle_m").filter(|(median, _)| *median >= LIMIT_CYCLE_M)?;
        Some(format!(
            "{} limit-cycles: ±{} m sideways before any fault, commanded thrust varies by {} N/s.",
            self.controller,
            short(median),
            short(self.metric("motor_total_variation_n_s").map_or(f64::NAN, |m| m.0))
        ))
    }
}

impl Comparison<'_> {
    /// What a reader should not miss, each with its number.
    pub fn findings(&self) -> Vec<String> {
        let mut findings = Vec::new();
        for entry in &self.entries {
            findings.extend(entry.crash());
            findings.extend(entry.landing());
            findings.extend(entry.led_down());
            findings.extend(entry.refusal());
            findings.extend(entry.spin());
            if self.is_calm() {
                findings.extend(entry.limit_cycle());
            }
        }
        findings.extend(self.against_pid());
        findings.extend(self.against_oracle());
        findings.extend(self.against_physics());
        if self.scenario.plant == PlantKind::Paper {
            findings.push(
                "pid and raw fly the paper's cascade from the same starting gains; lgs flies its own, with the \
                 weight on the integral and thrust limits it never needs here."
                    .to_owned(),
            );
        }
        findings
    }

    /// Whether nothing but the controller itself moves the machine before the fault.
    fn is_calm(&self) -> bool {
        let wind = &self.scenario.wind;
        wind.gust_rms_n == 0.0
            && wind.torque_rms_nm == 0.0
            && !matches!(self.scenario.reference, Reference::Helix(_) | Reference::Weave(_))
    }

    /// The median of a metric under one controller, and under each of the others.
    fn beside(&self, controller: ControllerName, metric: &str) -> Option<(f64, Vec<(ControllerName, f64)>)> {
        let median = |entry: &Entry| Some((entry.controller, entry.metric(metric)?.0));
        let (this, others): (Vec<_>, Vec<_>) =
            self.entries.iter().filter_map(median).partition(|(name, _)| *name == controller);
        Some((this.first()?.1, others))
    }

    /// How much of fixed gains' altitude deviation is left.
    fn against_pid(&self) -> Vec<String> {
        let Some((fixed, others)) = self.beside(ControllerName::Pid, "altitude_deviation_max_m") else {
            return Vec::new();
        };
        let say = |(name, adaptive): (ControllerName, f64)| {
            let ratio = if adaptive < fixed {
                format!("{} times less", short(fixed / adaptive))
            } else {
                format!("{} times more", short(adaptive / fixed))
            };
            let (adaptive, fixed) = (short(adaptive), short(fixed));
            format!("{name} is off in altitude by {adaptive} m in the fault, pid by {fixed} m: {ratio}.")
        };
        others.into_iter().map(say).collect()
    }

    /// How far each is from one who knows the fault at once.
    fn against_oracle(&self) -> Vec<String> {
        let mut findings = Vec::new();
        for (metric, what) in [("altitude_deviation_max_m", "in altitude"), ("lateral_deviation_max_m", "sideways")] {
            let Some((known, others)) = self.beside(ControllerName::Oracle, metric) else { continue };
            findings.extend(others.into_iter().map(|(name, found)| {
                let ratio = short(found / known);
                let (found, known) = (length(found), length(known));
                format!("{name} is off by {found} {what}, the oracle by {known}: {ratio} times.")
            }));
        }
        findings
    }

    /// Each fault beside the largest that a hover of this machine survives at all, and what still turns the machine.
    fn against_physics(&self) -> Vec<String> {
        if self.scenario.plant == PlantKind::Paper {
            return Vec::new();
        }
        let vehicle = self.scenario.vehicle();
        let faults = &self.scenario.fault;
        let mut findings = Vec::new();
        for onset in faults {
            findings.push(match onset.kind.loss() {
                Some(loss) => beside_loss(&vehicle, onset.rotors, loss),
                None if self.scenario.plant == PlantKind::Rigid => beside_others(&vehicle, onset),
                None => continue,
            });
            findings.extend(grip(&vehicle, &thrusts_under(&vehicle, &together(faults, onset.from_s))));
        }
        let mut said = std::collections::BTreeSet::new();
        findings.retain(|finding| said.insert(finding.clone()));
        findings
    }
}

fn beside_loss(vehicle: &Vehicle, rotors: Rotors, loss: f64) -> String {
    let limit = |heading| loss_max(vehicle, rotors, heading).map_or_else(|| "none".to_owned(), percent);
    format!(
        "The fault takes {} of {}; a hover survives up to {} with its heading, {} without.",
        percent(loss),
        in_words(rotors),
        limit(Heading::Held),
        limit(Heading::GivenUp)
    )
}

fn beside_others(vehicle: &Vehicle, fault: &Fault) -> String {
    let what = match hover(vehicle, &thrusts_under(vehicle, &[fault])) {
        Hover::WithHeading => "a hover survives it, heading included",
        Hover::WithoutHeading => "a hover survives it, but not the heading",
        Hover::Nowhere => "no hover survives it",
    };
    format!("The fault is `{}` on {}: by statics {what}.", fault.kind.name(), in_words(fault.rotors))
}

/// An axis that the rotors cannot turn the machine about both ways while they carry it.
fn grip(vehicle: &Vehicle, thrusts: &Thrusts) -> Option<String> {
    if hover(vehicle, thrusts) == Hover::Nowhere {
        return None;
    }
    (0..2).find_map(|arm| {
        let (low, high) = torque_nm(vehicle, thrusts, arm)?;
        if low < -NO_TORQUE_NM && high > NO_TORQUE_NM {
            return None;
        }
        let how = if high - low < NO_TORQUE_NM {
            "cannot turn it at all".to_owned()
        } else {
            format!("turn it one way only, by up to {:.2} N m,", high.max(-low))
        };
        let arms = in_words(Rotors::new(std::array::from_fn(|i| i % 2 == arm)));
        Some(format!(
            "While the rotors carry the weight they {how} about the axis through {arms}: only a spin brings it back."
        ))
    })
}
