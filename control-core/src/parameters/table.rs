//! The declarations of all parameters.
use super::Declaration;

macro_rules! parameters {
    ($($id:ident $name:literal [$unit:literal] $min:literal ..= $max:literal $(by $step:literal)?, $default:literal, $text:literal;)+) => {
        /// Which one: its place in [`TABLE`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Parameter { $(#[doc = $text] $id),+ }

        /// All of them.
        pub const TABLE: [Declaration; [$($name),+].len()] = [$(Declaration {
            name: $name,
            unit: $unit,
            min: $min,
            max: $max,
            step: 0.0 $(+ $step)?,
            default: $default,
            text: $text,
        }),+];
    };
}

parameters! {
    StickDead "STICK_DEAD" [""] 0.0..=0.3, 0.05, "Share of a stick's travel about its centre that means nothing.";
    StickExpo "STICK_EXPO" [""] 0.0..=0.9, 0.3, "How much finer the sticks are about their centre: 0 is straight.";
    ManualTilt "MAN_TILT_MAX" ["deg"] 5.0..=45.0, 30.0, "Tilt at full stick in angle and altitude hold.";
    ManualRate "MAN_RATE_MAX" ["deg/s"] 20.0..=400.0, 150.0, "Roll and pitch rate at full stick in rate mode.";
    ManualYaw "MAN_YAW_MAX" ["deg/s"] 10.0..=120.0, 90.0, "Yaw rate at full stick; the yaw guard brakes from 143 on.";
    SpeedMax "POS_SPEED_MAX" ["m/s"] 0.5..=15.0, 5.0, "Horizontal speed at full stick in position hold.";
    AccelerationMax "POS_ACC_MAX" ["m/s2"] 0.3..=4.0, 2.5, "Horizontal acceleration in position hold and return.";
    ClimbMax "ALT_CLIMB_MAX" ["m/s"] 0.2..=6.0, 2.0, "Climb rate at full stick.";
    SinkMax "ALT_SINK_MAX" ["m/s"] 0.2..=4.0, 1.5, "Sink rate at full stick.";
    TakeOffHeight "TKO_HEIGHT" ["m"] 0.5..=50.0, 2.5, "Height above home at which take-off ends.";
    TakeOffSpeed "TKO_SPEED" ["m/s"] 0.2..=4.0, 1.0, "Climb rate in take-off.";
    LandSpeed "LAND_SPEED" ["m/s"] 0.2..=2.0, 0.7, "Sink rate in land and descend.";
    LandSlow "LAND_SLOW" ["m/s"] 0.1..=1.0, 0.3, "Sink rate near the ground.";
    LandSlowHeight "LAND_SLOW_H" ["m"] 0.3..=20.0, 2.0, "Height above home below which it sinks slowly.";
    ReturnHeight "RTL_HEIGHT" ["m"] 0.0..=120.0, 15.0, "Height above home at which it returns, if it is not higher already.";
    ReturnSpeed "RTL_SPEED" ["m/s"] 0.5..=15.0, 5.0, "Speed of the return.";
    FsLinkS "FS_LINK_S" ["s"] 0.1..=10.0, 0.5, "Age of the pilot's last word at which the link is lost.";
    FsOffboardS "FS_OFFB_S" ["s"] 0.05..=5.0, 0.5, "Age of a setpoint from outside at which it is stale.";
    FsTilt "FS_TILT" ["deg"] 50.0..=120.0, 80.0, "Tilt that ends the flight if it lasts a second.";
    FenceRadius "FENCE_RADIUS" ["m"] 0.0..=5000.0, 0.0, "Distance from home of the fence; 0 for none.";
    FenceHeight "FENCE_HEIGHT" ["m"] 0.0..=1000.0, 120.0, "Height above home of the fence; 0 for none.";
    BatCells "BAT_CELLS" [""] 0.0..=14.0, 0.0, "Cells of the battery in series; 0: its voltage is not heeded.";
    BatLowV "BAT_LOW_V" ["V"] 2.5..=4.2, 3.5, "Voltage of a cell that is low.";
    BatCriticalV "BAT_CRIT_V" ["V"] 2.5..=4.2, 3.3, "Voltage of a cell that is critical.";
    BatUseMax "BAT_USE_MAX" ["mAh"] 0.0..=50000.0, 0.0, "Charge used since the start at which the battery is low; 0 for any.";
    BatDivider "BAT_V_DIV" [""] 0.0..=40.0, 0.0, "Battery voltage over the converter's; 0: as the board has it.";
    BatAmperes "BAT_A_PER_V" ["A/V"] 0.0..=500.0, 0.0, "Battery current over the converter's voltage; 0: as the board has it.";
    BatOffset "BAT_A_OFF" ["A"] -20.0..=20.0, 0.0, "What the current sensor reads too much, at any current.";
    ArmTilt "ARM_TILT_MAX" ["deg"] 1.0..=45.0, 15.0, "Tilt up to which it arms.";
    ArmMotors "ARM_MOTORS" [""] 0.0..=1.0, 0.0, "1: it arms only after the wiring check has passed.";
    MotorIdle "MOT_IDLE" [""] 0.0..=0.2, 0.05, "Command of a motor that idles on the ground, share of full.";
    MotorProtocol "MOT_PROTOCOL" [""] 0.0..=600.0 by 300.0, 600.0, "Sent to motors: 600 DShot600, 300 DShot300, 0 pulses of 1 to 2 ms.";
    MotorPoles "MOT_POLES" [""] 2.0..=60.0, 14.0, "Magnets of a motor, counted one by one.";
    DshotBidirectional "DSHOT_BIDIR" [""] 0.0..=1.0, 1.0, "1: speed controllers tell their rotors' speeds; 0 if they cannot.";
    GainTilt "GAIN_TILT" [""] 0.5..=2.0, 1.0, "Factor on the gains of roll and pitch.";
    GainHorizontal "GAIN_HORIZ" [""] 0.5..=2.0, 1.0, "Factor on the gains of north and east.";
    GainAltitude "GAIN_ALT" [""] 0.5..=2.0, 1.0, "Factor on the gains of altitude.";
    GainHeading "GAIN_HEADING" [""] 0.5..=2.0, 1.0, "Factor on the gains of heading.";
    AccOffX "ACC_OFF_X" ["m/s2"] -1.0..=1.0, 0.0, "What the accelerometer reads too much forward.";
    AccOffY "ACC_OFF_Y" ["m/s2"] -1.0..=1.0, 0.0, "The same to the right.";
    AccOffZ "ACC_OFF_Z" ["m/s2"] -1.0..=1.0, 0.0, "The same down.";
    MagOffX "MAG_OFF_X" ["uT"] -200.0..=200.0, 0.0, "Hard iron at the compass, forward.";
    MagOffY "MAG_OFF_Y" ["uT"] -200.0..=200.0, 0.0, "The same to the right.";
    MagOffZ "MAG_OFF_Z" ["uT"] -200.0..=200.0, 0.0, "The same down.";
    MagIronXx "MAG_IRON_XX" [""] 0.3..=3.0, 1.0, "What undoes soft iron at the compass, row x, column x.";
    MagIronXy "MAG_IRON_XY" [""] -1.0..=1.0, 0.0, "The same, row x, column y.";
    MagIronXz "MAG_IRON_XZ" [""] -1.0..=1.0, 0.0, "The same, row x, column z.";
    MagIronYx "MAG_IRON_YX" [""] -1.0..=1.0, 0.0, "The same, row y, column x.";
    MagIronYy "MAG_IRON_YY" [""] 0.3..=3.0, 1.0, "The same, row y, column y.";
    MagIronYz "MAG_IRON_YZ" [""] -1.0..=1.0, 0.0, "The same, row y, column z.";
    MagIronZx "MAG_IRON_ZX" [""] -1.0..=1.0, 0.0, "The same, row z, column x.";
    MagIronZy "MAG_IRON_ZY" [""] -1.0..=1.0, 0.0, "The same, row z, column y.";
    MagIronZz "MAG_IRON_ZZ" [""] 0.3..=3.0, 1.0, "The same, row z, column z.";
    MagMotX "MAG_MOT_X" ["uT"] -200.0..=200.0, 0.0, "Field of all motors at full thrust, forward.";
    MagMotY "MAG_MOT_Y" ["uT"] -200.0..=200.0, 0.0, "The same to the right.";
    MagMotZ "MAG_MOT_Z" ["uT"] -200.0..=200.0, 0.0, "The same down.";
}
