//! The mathematics of H. Gao, X. Li, C. Gao, J. Wu, "Neural Network Supervision Control Strategy for
//! Inverted Pendulum Tracking Control" (Discrete Dynamics in Nature and Society, 2021), and nothing
//! else: no FMI, no I/O, no allocation. It runs on a microcontroller as well as inside an FMU, and
//! gives the same bits on every platform: transcendental functions are its own [`exp`](exp::exp) and those
//! of `libm`.
//!
//! The plant is a cart (mass `M`, friction `b`, driven by the force `u`) with a pendulum (mass `m`,
//! inertia `I`, distance `l` to its centre of mass) pivoted on it at the angle `theta`:
//!
//! ```text
//! (M+m) x'' - m l theta'' cos(theta) + m l theta'^2 sin(theta) + b x' = u           (7)
//! (I+m l^2) theta'' - m g l sin(theta) = m l x'' cos(theta)                         (8)
//! ```
//!
//! Every `ts` seconds, a controller reads the set-point `r`, the measured angle `y` and its
//! disturbance `d`, and computes the force
//!
//! ```text
//! e = r - (y + d)
//! u = clip(u_p + u_n),   u_p = kp e + kd (e - e_before)/ts + ki sum(e ts),   u_n = sum_j w_j h_j(r)
//! ```
//!
//! where the network learns by gradient descent on its weights `w` to produce all of `u`:
//!
//! | module | contents | equations |
//! |---|---|---|
//! | [`plant`] | linear, nonlinear and transfer-function model of the pendulum | (7) to (11), (40), (41) |
//! | [`pid`] | the terms of the error and the [`Pid`] | (20), (25), (26) |
//! | [`rbf`] | the network and its learning rule | (12) to (14), (18), (19) |
//! | [`exp`] | the exponential function, for the Gaussians (12) | |
//! | [`learning`] | [`PidRbf`] and [`IpidRbf`] | (23), (24), (28), (29) |
//! | [`signal`] | set-points and the disturbance | section 4 |
//! | [`closed_loop`] | plant and controller together, with the paper's settings | section 4 |
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "std")]
extern crate std;

pub mod closed_loop;
pub mod exp;
pub mod learning;
pub mod pid;
pub mod plant;
pub mod rbf;
pub mod signal;
mod vector;

pub use learning::{IpidRbf, PidRbf, Target};
pub use pid::Pid;
pub use rbf::Rbf;

/// Limits `u` (N) to `-u_max ..= u_max` (the actuator limit of section 4). NaN stays NaN.
#[inline(always)]
pub(crate) fn clip(u: f64, u_max: f64) -> f64 {
    // Not `f64::clamp`, which panics on a NaN limit, nor `min` and `max`, which would hide a NaN in `u`. Each of these
    // is one instruction: a branch would be mispredicted while the force jumps from limit to limit.
    let u = if u_max < u { u_max } else { u };
    if -u_max > u { -u_max } else { u }
}
