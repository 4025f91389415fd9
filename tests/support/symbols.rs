//! The symbols of docs/theory.md, and a flight in f64 that its bounds are read off.
use control_core::math::tanh;
use control_core::{AxisConfig, AxisTelemetry, Config, Controller, Input, State};
use std::collections::VecDeque;

/// The configurations of x, y, z and heading.
pub fn axes(config: &Config) -> [AxisConfig; 4] {
    let gains = &config.gains;
    [gains.x, gains.y, gains.z, gains.psi]
}

/// A flight in f64 that knows how long each lesson was.
pub struct Flown {
    /// The law.
    pub controller: Controller<f64>,
    /// What it remembers.
    pub state: State<f64>,
    dt_s_range: (f64, f64),
    last_s: VecDeque<f64>,
}

impl Flown {
    /// At hover.
    ///
    /// # Panics
    /// If the configuration cannot fly.
    pub fn new(config: &Config) -> Self {
        let controller = Controller::try_new(config).expect("a valid configuration");
        let state = controller.hover_state();
        let period_s = 1.0 / f64::from(config.control_hz);
        let last_s = VecDeque::from([0.0; 4]);
        Self { controller, state, dt_s_range: (0.25 * period_s, 4.0 * period_s), last_s }
    }

    /// One tick.
    pub fn tick(&mut self, input: &Input<f64>) {
        if !self.controller.tick(&mut self.state, input).rejected {
            self.last_s.pop_front();
            self.last_s.push_back(input.dt_s.clamp(self.dt_s_range.0, self.dt_s_range.1));
        }
    }

    /// How long the last lesson was, whosever turn it was: the last four ticks.
    pub fn lesson_s(&self) -> f64 {
        self.last_s.iter().sum()
    }

    /// What the axes thought last.
    pub fn axes(&self) -> [AxisTelemetry<f64>; 4] {
        self.controller.telemetry(&self.state).axes
    }

    /// What the axes would think after this sample.
    pub fn after(&self, input: &Input<f64>) -> [AxisTelemetry<f64>; 4] {
        let mut state = self.state;
        self.controller.tick(&mut state, input);
        self.controller.telemetry(&state).axes
    }
}

/// The numbers of one axis as the page names them.
pub struct Symbols {
    /// ρ = ν / k0².
    pub rho: [f64; 3],
    /// Starting gains (k_p, k_i, k_d).
    pub k0: [f64; 3],
    /// u_s.
    pub scale: f64,
    /// α.
    pub alpha: f64,
    /// β.
    pub beta: f64,
    /// ε.
    pub eps: f64,
    /// λ.
    pub lambda: f64,
    /// d.
    pub dead_zone: f64,
    /// σ.
    pub leak: f64,
}

impl Symbols {
    /// Of an axis.
    pub fn of(config: &AxisConfig) -> Self {
        let (k0, lgs, f) = (config.k0, config.lgs, f64::from);
        Self {
            rho: core::array::from_fn(|j| f(lgs.nu[j] / (k0[j] * k0[j]))),
            k0: k0.map(f),
            scale: f(lgs.scale),
            alpha: f(lgs.alpha),
            beta: f(lgs.beta),
            eps: f(lgs.eps),
            lambda: f(lgs.lambda),
            dead_zone: f(lgs.dead_zone),
            leak: f(lgs.leak_1_s),
        }
    }

    /// w: what is missing of the command, as an acceleration.
    pub fn missing(&self, axis: &AxisTelemetry<f64>) -> f64 {
        axis.s_rate + self.alpha * axis.s + self.beta * tanh(axis.s / self.eps)
    }

    /// r: w outside the dead zone.
    pub fn residual(&self, axis: &AxisTelemetry<f64>) -> f64 {
        let w = self.missing(axis);
        w - w.clamp(-self.dead_zone, self.dead_zone)
    }

    /// The page's bound of |κ̇_j| where |ë| is at most `accel`.
    pub fn speed_max(&self, j: usize, accel: f64) -> f64 {
        let [p, _, d] = self.k0;
        let c = [self.scale * self.alpha * self.lambda / p, 0.0, self.scale * (self.lambda + self.alpha) / d];
        let b = f64::midpoint(c[j], c[0].hypot(c[2]));
        self.rho[j] * self.scale * (b + b.hypot(accel + self.beta)) / 2.0 + 2.0 * self.leak
    }
}

/// s̄(D): where α s + β tanh(s/ε) = D.
pub fn root(alpha: f64, beta: f64, eps: f64, most: f64) -> f64 {
    let (mut low, mut high) = (0.0, most / alpha);
    for _ in 0..200 {
        let middle = f64::midpoint(low, high);
        if alpha * middle + beta * tanh(middle / eps) < most { low = middle } else { high = middle }
    }
    high
}
