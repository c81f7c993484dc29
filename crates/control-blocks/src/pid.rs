//! The PID controller.

/// PID controller with filtered derivative, set-point weights, limits, anti-windup and bumpless transfer.
///
/// ```text
/// u = sat(P + I + D)       sat: u_min <= u <= u_max
/// P = kp (b r - y)
/// D = kd s / (1 + tf s) (c r - y)
/// I = 1/s (ki (r - y) + (u - (P + I + D)) / tt)
/// ```
///
/// In discrete time, D takes backward differences, and I is summed after the output is computed, as in the program of
/// K. J. Astrom and R. M. Murray, *Feedback Systems* (Princeton, 2008), section 10.5; section 10.4 has the
/// anti-windup by back-calculation.
///
/// - **No kick**: by default, the derivative acts on the measured value alone (c = 0), and it is 0 in the first step.
/// - **No windup**: while the output is limited, the integral tracks the limit with the time constant `tt`. If the
///   limit is elsewhere, in the actuator or an inner loop, call [`back_calculate`](Self::back_calculate) with the value
///   that was applied.
/// - **Manual and automatic**: call [`track`](Self::track) in place of [`update`](Self::update) as long as something
///   else determines the output; the next `update` goes on from there.
/// - **Parameters** may change at any time. If ki is not 0, changes of kp and b leave P + I as it is, after K. J.
///   Astrom and T. Hagglund, *PID Controllers: Theory, Design, and Tuning* (2nd ed., ISA, 1995), chapter 3, and
///   changes of the other gains do not move the output either. A controller without integral action would keep the
///   correction forever, so its output jumps.
///
/// ```
/// use control_blocks::Pid;
///
/// let mut pid = Pid { kp: 2.0, ki: 1.0, u_min: -3.0, u_max: 3.0, ..Pid::default() };
/// assert_eq!(pid.update(1.0, 0.0, 0.1), 2.0);
/// assert_eq!(pid.update(1.0, 0.0, 0.1), 2.1); // 0.1 s later
/// assert_eq!(pid.update(5.0, 0.0, 0.1), 3.0); // limited
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(
    feature = "fmi",
    derive(fmu_derive::Variables),
    variables(crate = fmu_description, default)
)]
pub struct Pid {
    /// Proportional gain.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1))]
    pub kp: f64,
    /// Integral gain, per second.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub ki: f64,
    /// Derivative gain, times seconds.
    #[cfg_attr(feature = "fmi", parameter(tunable))]
    pub kd: f64,
    /// Time constant of the filter of the derivative (s).
    #[cfg_attr(feature = "fmi", parameter(tunable, min = 0, unit = "s"))]
    pub tf: f64,
    /// Tracking time constant of the anti-windup (s); 0 for the rule sqrt(kd/ki), or kp/ki without derivative.
    #[cfg_attr(feature = "fmi", parameter(tunable, min = 0, unit = "s"))]
    pub tt: f64,
    /// Weight of the set-point in the proportional term.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1, unit = "1"))]
    pub b: f64,
    /// Weight of the set-point in the derivative.
    #[cfg_attr(feature = "fmi", parameter(tunable, unit = "1"))]
    pub c: f64,
    /// Lower limit of the output.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = -1e30))]
    pub u_min: f64,
    /// Upper limit of the output.
    #[cfg_attr(feature = "fmi", parameter(tunable, start = 1e30))]
    pub u_max: f64,
    /// State: the integral part of the output.
    pub integral: f64,
    /// State: the derivative part of the output.
    pub derivative: f64,
    /// State: set-point, measured value, unlimited output, kp and b of the last step; none before the first.
    pub last: Option<[f64; 5]>,
}

impl Default for Pid {
    fn default() -> Self {
        Self {
            kp: 1.0,
            ki: 0.0,
            kd: 0.0,
            tf: 0.0,
            tt: 0.0,
            b: 1.0,
            c: 0.0,
            u_min: -1e30,
            u_max: 1e30,
            integral: 0.0,
            derivative: 0.0,
            last: None,
        }
    }
}

impl Pid {
    /// The output for the set-point `r` and the measured value `y`, after a step of `dt` (s), positive.
    pub fn update(&mut self, r: f64, y: f64, dt: f64) -> f64 {
        let proportional = self.advance(r, y, dt);
        let unlimited = proportional + self.integral + self.derivative;
        let u = crate::clip(unlimited, self.u_min, self.u_max);
        self.last = Some([r, y, unlimited, self.kp, self.b]);
        self.back_calculate(u, dt);
        self.integral += self.ki * (r - y) * dt;
        u
    }

    /// Follows another output `u`, for example one set by hand, so that the next [`update`](Self::update) goes on from
    /// it without a jump. Returns `u` within the limits.
    pub fn track(&mut self, u: f64, r: f64, y: f64, dt: f64) -> f64 {
        let proportional = self.advance(r, y, dt);
        let u = crate::clip(u, self.u_min, self.u_max);
        self.integral = u - proportional - self.derivative;
        self.last = Some([r, y, u, self.kp, self.b]);
        u
    }

    /// Reduces windup behind the controller: tells it the value that was `applied` in place of the last output, with
    /// the step `dt` (s) of the update.
    pub fn back_calculate(&mut self, applied: f64, dt: f64) {
        let Some([_, _, last, _, _]) = &mut self.last else { return };
        if self.ki != 0.0 {
            let tracking_time = match self.tt {
                0.0 if self.kd != 0.0 => libm::sqrt((self.kd / self.ki).abs()),
                0.0 => (self.kp / self.ki).abs(),
                tt => tt,
            };
            // At most the whole difference: more would oscillate.
            self.integral += (applied - *last) * (dt / tracking_time.max(dt));
        }
        *last = applied;
    }

    /// Forgets all steps; parameters stay.
    pub fn reset(&mut self) {
        (self.integral, self.derivative, self.last) = (0.0, 0.0, None);
    }

    /// Advances the derivative, and returns the proportional part.
    fn advance(&mut self, r: f64, y: f64, dt: f64) -> f64 {
        let Self { kp, ki, kd, tf, b, c, .. } = *self;
        let [last_r, last_y, _, last_kp, last_b] = self.last.unwrap_or([r, y, 0.0, kp, b]);
        let change = c * (r - last_r) - (y - last_y);
        self.derivative = (tf * self.derivative + kd * change) / (tf + dt);
        if ki != 0.0 && (kp, b) != (last_kp, last_b) {
            self.integral += last_kp * (last_b * r - y) - kp * (b * r - y);
        }
        kp * (b * r - y)
    }
}
