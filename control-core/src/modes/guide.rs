//! The guide: from a mode, the sticks and the estimate to what the controller is asked for.
//!
//! ```text
//! v ← v + clamp(v_wanted − v, a dt)        p ← p + v dt        |p − measured| ≤ leash
//! towards a place at the distance d:  v_wanted = min(v_max, √(a d)),  so that half of a suffices to stop
//! ```
//!
//! One setpoint serves all modes and moves no faster than its limits. A mode that takes over begins where the last one left
//! it, or, of what the last one did not hold, at the estimate: position, velocity and heading as measured. On a leash it
//! never runs away from a machine that cannot follow.
use super::blind::Blind;
use super::{Level, Mode};
use crate::estimate::Estimate;
use crate::frames::{Body, Ned, Vec3};
use crate::math::{atan2, wrap_pi};
use crate::parameters::{Parameter, Parameters};
use crate::pilot::Reading;
use crate::signals::Setpoint;
use crate::{Airframe, Lift, Scalar, Target};

/// Largest distance of the setpoint from the machine, horizontal and vertical, m.
const LEASH_M: (f32, f32) = (3.0, 1.0);
/// Vertical acceleration, m/s².
const VERTICAL_M_S2: f32 = 2.0;
/// Heading the setpoint may lead by, rad: less than what the yaw guard takes for a loss of control.
const YAW_LEASH_RAD: f32 = 0.25;
/// Share of the yaw torque of a hover that the setpoint of the heading asks for.
const YAW_SHARE: f32 = 0.5;
/// Distance within which the machine has arrived, and its setpoint, m.
const ARRIVED_M: f32 = 0.3;
const SETTLED_M: f32 = 0.1;
/// Distance from home within which a return lands without climbing, m.
const NEAR_HOME_M: f32 = 3.0;
/// How the setpoint may move, and what the machine carries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    tilt_rad: f32,
    rate_rad_s: f32,
    yaw_rad_s: f32,
    yaw_rad_s2: f32,
    speed_m_s: f32,
    acceleration_m_s2: f32,
    climb_m_s: f32,
    sink_m_s: f32,
    take_off: Leg,
    land_m_s: f32,
    land_slow_m_s: f32,
    land_slow_m: f32,
    home: Leg,
    weight_n: f32,
    thrust_n_max: f32,
}

/// How high and how fast.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Leg {
    height_m: f32,
    speed_m_s: f32,
}

impl Limits {
    /// As the parameters say, of this machine.
    pub fn new(parameters: &Parameters, airframe: &Airframe) -> Self {
        let p = |parameter| parameters[parameter];
        Self {
            tilt_rad: parameters.rad(Parameter::ManualTilt),
            rate_rad_s: parameters.rad(Parameter::ManualRate),
            yaw_rad_s: parameters.rad(Parameter::ManualYaw),
            yaw_rad_s2: YAW_SHARE * airframe.torque_per_thrust_m * airframe.weight_n() / airframe.inertia_kg_m2[2],
            speed_m_s: p(Parameter::SpeedMax),
            acceleration_m_s2: p(Parameter::AccelerationMax),
            climb_m_s: p(Parameter::ClimbMax),
            sink_m_s: p(Parameter::SinkMax),
            take_off: Leg { height_m: p(Parameter::TakeOffHeight), speed_m_s: p(Parameter::TakeOffSpeed) },
            land_m_s: p(Parameter::LandSpeed),
            land_slow_m_s: p(Parameter::LandSlow),
            land_slow_m: p(Parameter::LandSlowHeight),
            home: Leg { height_m: p(Parameter::ReturnHeight), speed_m_s: p(Parameter::ReturnSpeed) },
            weight_n: airframe.weight_n(),
            thrust_n_max: airframe.rotors.iter().map(|rotor| rotor.thrust_n_max).sum(),
        }
    }

    /// Thrust of a throttle, N: none, the weight in the middle, all at the top.
    fn thrust_n(&self, throttle: f32) -> f32 {
        let up = throttle + throttle;
        if up < 1.0 { up * self.weight_n } else { self.weight_n + (up - 1.0) * (self.thrust_n_max - self.weight_n) }
    }
}

/// Where it took off, of what was known then.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Home {
    /// North and east, m.
    pub place_m: Option<[f32; 2]>,
    /// Down, m.
    pub down_m: Option<f32>,
}

/// What the guide sees in one tick.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// The estimate.
    pub estimate: &'a Estimate,
    /// What of it is flown on.
    pub level: Level,
    /// The pilot.
    pub pilot: &'a Reading,
    /// Where it took off.
    pub home: Home,
    /// The last setpoint from outside, if it is fresh.
    pub offboard: Option<&'a Setpoint>,
    /// Time since the last tick, s.
    pub dt_s: f32,
}

impl Scene<'_> {
    /// Height above home, if home is known, m.
    fn height_m(&self) -> Option<f32> {
        Some(self.home.down_m? - self.estimate.position_m.z)
    }

    fn yaw_rad(&self) -> f32 {
        let [[north, ..], [east, ..], _] = self.estimate.attitude.rows;
        atan2(east, north)
    }
}

/// The setpoint, and where in its mode it is.
#[derive(Clone, Copy, Debug)]
pub struct Guide {
    mode: Mode,
    setpoint: Setpoint,
    /// Down of the return's way home, m.
    cruise_down_m: f32,
    arrived: bool,
    /// A descent without altitude.
    blind: Option<Blind>,
    /// Whether the throttle has been up to its middle since the mode began: before that, low means nothing.
    throttle_seen: bool,
}

impl Guide {
    /// Before a flight: the next mode begins at the estimate.
    pub const AT_REST: Self = Self {
        mode: Mode::Disarmed,
        setpoint: Setpoint {
            position_m: Vec3::zero(),
            velocity_m_s: Vec3::zero(),
            acceleration_m_s2: Vec3::zero(),
            yaw_rad: 0.0,
            yaw_rate_rad_s: 0.0,
        },
        cruise_down_m: 0.0,
        arrived: false,
        blind: None,
        throttle_seen: false,
    };

    /// Whether the mode has done what it is for: at height, or at home.
    pub fn arrived(&self) -> bool {
        self.arrived
    }

    /// How deep the setpoint of a mode that comes down is below `estimate`, m.
    pub fn below_m(&self, estimate: &Estimate) -> Option<f32> {
        self.mode.comes_down().then_some(self.setpoint.position_m.z - estimate.position_m.z)
    }

    /// What the controller is asked for in this tick.
    pub fn step(&mut self, limits: &Limits, mode: Mode, scene: &Scene) -> Target {
        if mode != self.mode {
            self.enter(limits, mode, scene);
        }
        let sticks = &scene.pilot.sticks;
        match mode {
            Mode::Disarmed => Target::Ground { share: 0.0 },
            Mode::Rate => Target::Rates {
                rate_rad_s: Vec3::<Body>::new(
                    sticks.right * limits.rate_rad_s,
                    -sticks.forward * limits.rate_rad_s,
                    sticks.clockwise * limits.yaw_rad_s,
                ),
                thrust_n: limits.thrust_n(sticks.throttle),
            },
            Mode::Angle => by_tilt(limits, scene, Lift::Thrust(limits.thrust_n(sticks.throttle))),
            Mode::AltitudeHold => {
                let wanted_m_s = self.by_stick(limits, scene.pilot.climb);
                self.climb(wanted_m_s, scene);
                by_tilt(limits, scene, self.lift())
            }
            Mode::PositionHold => {
                self.fly_by_sticks(limits, scene);
                Target::Position(self.setpoint)
            }
            Mode::Offboard => {
                self.setpoint = scene.offboard.copied().unwrap_or(self.setpoint);
                Target::Position(self.setpoint)
            }
            Mode::TakeOff => self.take_off(limits, scene),
            Mode::Return => self.go_home(limits, scene),
            Mode::Land => {
                self.travel([0.0; 2], limits.acceleration_m_s2, scene);
                self.climb(-sinking_m_s(limits, scene), scene);
                Target::Position(self.setpoint)
            }
            Mode::Descend => self.descend(limits, scene),
        }
    }

    /// Begins a mode: keeps of the setpoint what the last one held.
    fn enter(&mut self, limits: &Limits, mode: Mode, scene: &Scene) {
        let (position, velocity) = (scene.estimate.position_m, scene.estimate.velocity_m_s);
        // A setpoint from outside may be anywhere.
        let held = if self.mode == Mode::Offboard { Level::Nothing } else { self.mode.needs() };
        let setpoint = &mut self.setpoint;
        if held < Level::Velocity {
            (setpoint.position_m.x, setpoint.position_m.y) = (position.x, position.y);
            (setpoint.velocity_m_s.x, setpoint.velocity_m_s.y) = (velocity.x, velocity.y);
            setpoint.yaw_rad = scene.yaw_rad();
        }
        if held < Level::Altitude {
            (setpoint.position_m.z, setpoint.velocity_m_s.z) = (position.z, velocity.z);
        }
        setpoint.acceleration_m_s2 = Vec3::zero();
        setpoint.yaw_rate_rad_s = 0.0;
        self.mode = mode;
        self.arrived = false;
        self.blind = None;
        self.throttle_seen = false;
        let far = scene.home.place_m.is_some_and(|home| length(from(position, home)) > NEAR_HOME_M);
        let cruise_m = scene.home.down_m.map_or(position.z, |down_m| down_m - limits.home.height_m);
        self.cruise_down_m = if far { cruise_m.min(position.z) } else { position.z };
    }

    /// Climb rate of the throttle, m/s.
    fn by_stick(&mut self, limits: &Limits, climb: f32) -> f32 {
        self.throttle_seen |= climb >= 0.0;
        match climb {
            _ if climb > 0.0 => climb * limits.climb_m_s,
            _ if self.throttle_seen => climb * limits.sink_m_s,
            _ => 0.0,
        }
    }

    fn lift(&self) -> Lift {
        Lift::Altitude { down_m: self.setpoint.position_m.z, down_m_s: self.setpoint.velocity_m_s.z }
    }

    /// Moves the setpoint horizontally, at `wanted_m_s` north and east as soon as the limits allow.
    fn travel(&mut self, wanted_m_s: [f32; 2], acceleration_m_s2: f32, scene: &Scene) {
        let Setpoint { position_m, velocity_m_s, acceleration_m_s2: forward, .. } = &mut self.setpoint;
        let missing = [wanted_m_s[0] - velocity_m_s.x, wanted_m_s[1] - velocity_m_s.y];
        let step = shorten(missing, acceleration_m_s2 * scene.dt_s);
        (velocity_m_s.x, velocity_m_s.y) = (velocity_m_s.x + step[0], velocity_m_s.y + step[1]);
        (forward.x, forward.y) = (step[0] / scene.dt_s, step[1] / scene.dt_s);
        let measured = scene.estimate.position_m;
        let led = [
            position_m.x + velocity_m_s.x * scene.dt_s - measured.x,
            position_m.y + velocity_m_s.y * scene.dt_s - measured.y,
        ];
        let led = shorten(led, LEASH_M.0);
        (position_m.x, position_m.y) = (measured.x + led[0], measured.y + led[1]);
    }

    /// Moves the setpoint vertically, climbing at `wanted_m_s` as soon as the limits allow.
    fn climb(&mut self, wanted_m_s: f32, scene: &Scene) {
        let Setpoint { position_m, velocity_m_s, acceleration_m_s2, .. } = &mut self.setpoint;
        let most = VERTICAL_M_S2 * scene.dt_s;
        let step = (-wanted_m_s - velocity_m_s.z).clamp_abs(most);
        velocity_m_s.z += step;
        acceleration_m_s2.z = step / scene.dt_s;
        // One that is below its setpoint may be led down by the controller: only what is ahead is on a leash.
        let led_m = position_m.z + velocity_m_s.z * scene.dt_s - scene.estimate.position_m.z;
        let ahead = led_m * velocity_m_s.z > 0.0;
        position_m.z = scene.estimate.position_m.z + if ahead { led_m.clamp_abs(LEASH_M.1) } else { led_m };
    }

    fn fly_by_sticks(&mut self, limits: &Limits, scene: &Scene) {
        let sticks = &scene.pilot.sticks;
        let [[north, ..], [east, ..], _] = scene.estimate.attitude.rows;
        let [north, east] = shorten([north * BEYOND, east * BEYOND], 1.0);
        let pushed = shorten([sticks.forward, sticks.right], 1.0).map(|stick| stick * limits.speed_m_s);
        let wanted_m_s = [north * pushed[0] - east * pushed[1], east * pushed[0] + north * pushed[1]];
        self.travel(wanted_m_s, limits.acceleration_m_s2, scene);
        let wanted_m_s = self.by_stick(limits, scene.pilot.climb);
        self.climb(wanted_m_s, scene);
        self.turn(sticks.clockwise * limits.yaw_rad_s, limits.yaw_rad_s2, scene);
    }

    /// Turns the heading's setpoint, no further ahead of the nose than its leash.
    fn turn(&mut self, wanted_rad_s: f32, acceleration_rad_s2: f32, scene: &Scene) {
        let Setpoint { yaw_rad, yaw_rate_rad_s, .. } = &mut self.setpoint;
        let most = acceleration_rad_s2 * scene.dt_s;
        *yaw_rate_rad_s += (wanted_rad_s - *yaw_rate_rad_s).clamp_abs(most);
        // A machine that something else turns comes back to the setpoint: only the stick is on a leash.
        if *yaw_rate_rad_s != 0.0 {
            let nose_rad = scene.yaw_rad();
            let lead = wrap_pi(*yaw_rad + *yaw_rate_rad_s * scene.dt_s - nose_rad);
            *yaw_rad = wrap_pi(nose_rad + lead.clamp_abs(YAW_LEASH_RAD));
        }
    }

    fn take_off(&mut self, limits: &Limits, scene: &Scene) -> Target {
        let Leg { height_m, speed_m_s } = limits.take_off;
        let rise_m = scene.height_m().map_or(0.0, |above_m| height_m - above_m);
        self.arrived = rise_m < ARRIVED_M;
        self.travel([0.0; 2], limits.acceleration_m_s2, scene);
        self.climb(towards(rise_m.max(0.0), speed_m_s, VERTICAL_M_S2), scene);
        Target::Position(self.setpoint)
    }

    fn go_home(&mut self, limits: &Limits, scene: &Scene) -> Target {
        let rise_m = self.setpoint.position_m.z - self.cruise_down_m;
        let away_from = |position| scene.home.place_m.map_or([0.0; 2], |home| from(position, home));
        let away = away_from(self.setpoint.position_m);
        let far_m = length(away);
        self.arrived = far_m < SETTLED_M && length(away_from(scene.estimate.position_m)) < ARRIVED_M;
        let speed =
            if rise_m > ARRIVED_M { 0.0 } else { towards(far_m, limits.home.speed_m_s, limits.acceleration_m_s2) };
        let wanted_m_s = shorten(away.map(|m| -m * BEYOND), speed);
        self.travel(wanted_m_s, limits.acceleration_m_s2, scene);
        self.climb(towards(rise_m, limits.climb_m_s, VERTICAL_M_S2), scene);
        Target::Position(self.setpoint)
    }

    fn descend(&mut self, limits: &Limits, scene: &Scene) -> Target {
        let lift = if scene.level >= Level::Altitude {
            self.blind = None;
            self.climb(-sinking_m_s(limits, scene), scene);
            self.lift()
        } else {
            // Begins at the estimate when there is one again.
            self.setpoint.position_m.z = scene.estimate.position_m.z;
            self.setpoint.velocity_m_s.z = scene.estimate.velocity_m_s.z;
            let blind = self.blind.get_or_insert_with(|| Blind::begin(scene.estimate));
            Lift::Thrust(limits.weight_n * blind.step(scene.estimate, scene.dt_s))
        };
        Target::Angles { roll_rad: 0.0, pitch_rad: 0.0, yaw_rate_rad_s: 0.0, lift }
    }
}

/// Makes a vector longer than any limit, so that [`shorten`] gives it the limit's length.
const BEYOND: f32 = 1e6;

/// Tilt and yaw rate by the sticks.
fn by_tilt(limits: &Limits, scene: &Scene, lift: Lift) -> Target {
    let sticks = &scene.pilot.sticks;
    Target::Angles {
        roll_rad: sticks.right * limits.tilt_rad,
        pitch_rad: -sticks.forward * limits.tilt_rad,
        yaw_rate_rad_s: sticks.clockwise * limits.yaw_rad_s,
        lift,
    }
}

/// Sink rate of a landing, m/s: slow near the ground, and wherever the ground is not known.
fn sinking_m_s(limits: &Limits, scene: &Scene) -> f32 {
    let high = scene.height_m().is_some_and(|height_m| height_m > limits.land_slow_m);
    if high { limits.land_m_s } else { limits.land_slow_m_s }
}

/// Speed towards a place `distance` away that leaves room to stop.
fn towards(distance: f32, speed_max: f32, acceleration: f32) -> f32 {
    let braking = Scalar::sqrt(acceleration * distance.abs());
    let speed = Scalar::min(braking, speed_max);
    if distance < 0.0 { -speed } else { speed }
}

/// From `home` to `position`, north and east.
fn from(position: Vec3<Ned>, home: [f32; 2]) -> [f32; 2] {
    [position.x - home[0], position.y - home[1]]
}

pub(crate) fn length(v: [f32; 2]) -> f32 {
    Scalar::sqrt(v[0] * v[0] + v[1] * v[1])
}

/// The vector, or what of it is `most` long.
fn shorten(v: [f32; 2], most: f32) -> [f32; 2] {
    let long = length(v);
    if long > most { v.map(|x| x * (most / long)) } else { v }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Health, Sigma};
    use crate::frames::Attitude;
    use crate::pilot::Sticks;

    const DT_S: f32 = 0.002;

    fn at(position: [f32; 3], velocity: [f32; 3]) -> Estimate {
        let v = |[x, y, z]: [f32; 3]| Vec3::new(x, y, z);
        Estimate {
            time_us: 0,
            position_m: v(position),
            velocity_m_s: v(velocity),
            attitude: Attitude::level(),
            rate_rad_s: Vec3::zero(),
            specific_force_m_s2: Vec3::zero(),
            gyro_bias_rad_s: Vec3::zero(),
            accelerometer_bias_m_s2: Vec3::zero(),
            sigma: Sigma::default(),
            health: Health::default(),
        }
    }

    fn nobody() -> Reading {
        Reading {
            sticks: Sticks::NEUTRAL,
            climb: 0.0,
            arm: true,
            arm_rose: false,
            mode: Mode::PositionHold,
            mode_moved: false,
            age_s: 0.0,
        }
    }

    fn limits() -> Limits {
        Limits::new(&Parameters::default(), &Airframe::paper(2.2))
    }

    const HOME: Home = Home { place_m: Some([0.0, 0.0]), down_m: Some(0.0) };

    fn scene<'a>(estimate: &'a Estimate, pilot: &'a Reading) -> Scene<'a> {
        Scene { estimate, level: Level::Position, pilot, home: HOME, offboard: None, dt_s: DT_S }
    }

    fn position(target: Target) -> Setpoint {
        match target {
            Target::Position(setpoint) => setpoint,
            other => panic!("{other:?}"),
        }
    }

    /// The setpoint after `seconds` of `mode` with a machine that follows it exactly.
    fn follow(guide: &mut Guide, mode: Mode, pilot: &Reading, start: Estimate, seconds: f32) -> (Estimate, Setpoint) {
        let mut estimate = start;
        let mut setpoint = None;
        for _ in 0..(seconds / DT_S) as usize {
            let next = position(guide.step(&limits(), mode, &scene(&estimate, pilot)));
            (estimate.position_m, estimate.velocity_m_s) = (next.position_m, next.velocity_m_s);
            setpoint = Some(next);
        }
        (estimate, setpoint.expect("a tick"))
    }

    #[test]
    fn the_setpoint_keeps_its_limits_whatever_the_sticks_do() {
        let limits = limits();
        let (mut guide, mut seed) = (Guide::AT_REST, 1_u32);
        let mut estimate = at([0.0, 0.0, -20.0], [0.0; 3]);
        let mut pilot = nobody();
        let mut last = position(guide.step(&limits, Mode::PositionHold, &scene(&estimate, &pilot)));
        for tick in 0..100_000 {
            if tick % 200 == 0 {
                let mut draw = || {
                    seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (seed >> 8) as f32 / (1 << 23) as f32 - 1.0
                };
                pilot.sticks = Sticks { right: draw(), forward: draw(), clockwise: draw(), throttle: 0.5 };
                pilot.climb = draw();
            }
            let next = position(guide.step(&limits, Mode::PositionHold, &scene(&estimate, &pilot)));
            let change = next.velocity_m_s - last.velocity_m_s;
            assert!(length([change.x, change.y]) <= limits.acceleration_m_s2 * DT_S * 1.001);
            assert!(change.z.abs() <= VERTICAL_M_S2 * DT_S * 1.001);
            assert!(length([next.velocity_m_s.x, next.velocity_m_s.y]) <= limits.speed_m_s * 1.001);
            assert!((-limits.climb_m_s..=limits.sink_m_s).contains(&next.velocity_m_s.z));
            let led = next.position_m - estimate.position_m;
            assert!(length([led.x, led.y]) <= LEASH_M.0 * 1.001);
            assert!(led.z * next.velocity_m_s.z <= 0.0 || led.z.abs() <= LEASH_M.1 * 1.001);
            assert!(next.yaw_rad.abs() <= core::f32::consts::PI);
            // The machine follows, badly.
            estimate.position_m = estimate.position_m + led * 0.003;
            last = next;
        }
    }

    #[test]
    fn a_mode_begins_where_the_last_one_was_or_at_the_estimate() {
        let moving = at([5.0, -3.0, -10.0], [2.0, 1.0, -0.5]);
        let begin = |from: Mode, to: Mode| {
            let mut guide = Guide { mode: from, ..Guide::AT_REST };
            guide.setpoint.position_m = Vec3::new(5.5, -3.0, -10.2);
            position(guide.step(&limits(), to, &scene(&moving, &nobody())))
        };
        let near = |setpoint: Setpoint, x: f32, z: f32| {
            let p = setpoint.position_m;
            assert!((p.x - x).abs() < 0.01 && (p.z - z).abs() < 0.01, "{p:?}");
        };
        near(begin(Mode::PositionHold, Mode::Land), 5.5, -10.2);
        near(begin(Mode::AltitudeHold, Mode::PositionHold), 5.0, -10.2);
        near(begin(Mode::Angle, Mode::PositionHold), 5.0, -10.0);
        near(begin(Mode::Offboard, Mode::PositionHold), 5.0, -10.0);
        let first = begin(Mode::Angle, Mode::PositionHold);
        assert!((first.velocity_m_s.x - 2.0).abs() < 0.01, "and as fast as it is: {first:?}");
    }

    #[test]
    fn a_return_climbs_then_flies_home_and_stops_there() {
        let pilot = nobody();
        let mut guide = Guide::AT_REST;
        let (climbed, _) = follow(&mut guide, Mode::Return, &pilot, at([30.0, 40.0, -5.0], [0.0; 3]), 4.0);
        assert!(climbed.position_m.x > 29.9 && climbed.position_m.z < -8.0, "up first: {:?}", climbed.position_m);
        let (home, last) = follow(&mut guide, Mode::Return, &pilot, climbed, 30.0);
        let p = home.position_m;
        assert!(guide.arrived() && length([p.x, p.y]) < 0.1 && (p.z + 15.0).abs() < 0.4, "{p:?}");
        assert!(length([last.velocity_m_s.x, last.velocity_m_s.y]) < 0.2);
    }

    #[test]
    fn a_return_near_home_or_to_a_home_nobody_knows_lands_at_once() {
        let pilot = nobody();
        for (place_m, position_m) in [(Some([0.0; 2]), [0.05, 0.0, -5.0]), (None, [30.0, 0.0, -5.0])] {
            let estimate = at(position_m, [0.0; 3]);
            let mut guide = Guide::AT_REST;
            let unknown = Scene { home: Home { place_m, ..HOME }, ..scene(&estimate, &pilot) };
            let setpoint = position(guide.step(&limits(), Mode::Return, &unknown));
            assert!(guide.arrived() && (setpoint.position_m.z + 5.0).abs() < 0.01);
        }
    }

    #[test]
    fn landing_is_slow_near_the_ground_and_where_nobody_knows_the_ground() {
        let limits = limits();
        let pilot = nobody();
        let (high, low) = (at([0.0, 0.0, -9.0], [0.0; 3]), at([0.0, 0.0, -1.0], [0.0; 3]));
        let unknown = Scene { home: Home::default(), ..scene(&high, &pilot) };
        for (scene, want) in [(scene(&high, &pilot), 0.7), (scene(&low, &pilot), 0.3), (unknown, 0.3)] {
            assert_eq!(sinking_m_s(&limits, &scene), want);
        }
    }

    #[test]
    fn descending_is_level_and_without_altitude_a_little_less_than_the_weight() {
        let (mut guide, limits, pilot) = (Guide::AT_REST, limits(), nobody());
        let mut lost = at([0.0, 0.0, -9.0], [0.0; 3]);
        lost.position_m.z = f32::NAN;
        let blind = Scene { level: Level::Tilt, ..scene(&lost, &pilot) };
        let Target::Angles { roll_rad, pitch_rad, lift: Lift::Thrust(n), .. } =
            guide.step(&limits, Mode::Descend, &blind)
        else {
            panic!("by thrust")
        };
        assert!(roll_rad == 0.0 && pitch_rad == 0.0 && n > 0.8 * limits.weight_n && n < limits.weight_n);
        let found = at([0.0, 0.0, -7.0], [0.0, 0.0, 0.5]);
        guide.step(&limits, Mode::Descend, &Scene { level: Level::Tilt, ..scene(&found, &pilot) });
        let Target::Angles { lift: Lift::Altitude { down_m, .. }, .. } =
            guide.step(&limits, Mode::Descend, &scene(&found, &pilot))
        else {
            panic!("by altitude")
        };
        assert!((down_m + 7.0).abs() < 0.01, "it begins at the estimate: {down_m}");
    }

    #[test]
    fn the_throttle_carries_the_weight_in_its_middle() {
        let limits = limits();
        for (throttle, want) in [(0.0, 0.0), (0.25, 0.5), (0.5, 1.0), (1.0, 2.2)] {
            assert!((limits.thrust_n(throttle) - want * limits.weight_n).abs() < 1e-4, "{throttle}");
        }
    }
}
