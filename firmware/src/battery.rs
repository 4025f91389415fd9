//! Battery: what is at the converter's pins to volts and amperes.
//!
//! ```text
//! U = share · 3.3 V · divider        I = share · 3.3 V · amperes_per_v − offset
//! ```
//!
//! A line that is torn off or shorted reads as one end of the converter or the other. No battery has a voltage at either, and no current
//! is known at the upper one: what is read there is no reading. A current line at the lower end is a current of nothing.
use control_core::parameters::{Parameter, Parameters};

/// Reference of the converter, V.
const REFERENCE_V: f32 = 3.3;
/// Shares of it next to the ends: 0.4 V and 35.9 V behind a divider of 11.
const ENDS: [f32; 2] = [0.01, 0.99];

/// What the battery's lines stand for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Battery voltage over pin voltage.
    pub divider: f32,
    /// Current over pin voltage, A/V.
    pub amperes_per_v: f32,
    /// What is read of the current beyond what flows, A.
    pub offset_a: f32,
}

impl Scale {
    /// As parameters say, and where they say nothing as `self`.
    #[must_use]
    pub fn set_by(self, parameters: &Parameters) -> Self {
        let unless_0 = |parameter, or: f32| if parameters[parameter] > 0.0 { parameters[parameter] } else { or };
        Self {
            divider: unless_0(Parameter::BatDivider, self.divider),
            amperes_per_v: unless_0(Parameter::BatAmperes, self.amperes_per_v),
            offset_a: self.offset_a + parameters[Parameter::BatOffset],
        }
    }

    /// Volts at the battery, if that can be.
    ///
    /// - `share`: pin voltage over the converter's reference.
    pub fn volts(&self, share: f32) -> Option<f32> {
        (ENDS[0]..ENDS[1]).contains(&share).then_some(share * REFERENCE_V * self.divider)
    }

    /// Amperes out of the battery, if that can be.
    ///
    /// - `share`: pin voltage over the converter's reference.
    pub fn amperes(&self, share: f32) -> Option<f32> {
        (share < ENDS[1]).then_some(share * REFERENCE_V * self.amperes_per_v - self.offset_a)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCALE: Scale = Scale { divider: 11.0, amperes_per_v: 25.0, offset_a: 0.0 };

    #[test]
    fn a_full_four_cell_battery_is_16_8_volts_and_a_volt_of_current_25_amperes() {
        assert!((SCALE.volts(1_895.0 / 4_095.0).unwrap() - 16.8).abs() < 0.01);
        assert!((SCALE.amperes(1.0 / 3.3).unwrap() - 25.0).abs() < 1e-4);
        assert_eq!(SCALE.amperes(0.0), Some(0.0));
    }

    #[test]
    fn a_line_at_an_end_of_the_converter_is_no_reading() {
        assert_eq!([0.0, 0.005, 1.0].map(|share| SCALE.volts(share)), [None; 3]);
        assert_eq!(SCALE.amperes(1.0), None);
    }

    #[test]
    fn what_is_calibrated_takes_the_place_of_what_the_board_has() {
        let mut parameters = Parameters::default();
        assert_eq!(SCALE.set_by(&parameters), SCALE);
        for (name, value) in [("BAT_V_DIV", 10.5), ("BAT_A_PER_V", 40.0), ("BAT_A_OFF", 0.5)] {
            parameters.set(name, value).expect("in its range");
        }
        let set = SCALE.set_by(&parameters);
        assert_eq!(set, Scale { divider: 10.5, amperes_per_v: 40.0, offset_a: 0.5 });
        assert!((set.amperes(1.0 / 3.3).unwrap() - 39.5).abs() < 1e-4);
    }
}
