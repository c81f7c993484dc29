//! Set-points and the disturbance of section 4, as functions of time.

use core::f64::consts::PI;

/// Times this close (s) to a jump count as the jump, so that rounding in the host cannot move it.
fn tolerance(time: f64) -> f64 {
    1e-9 + 4.0 * f64::EPSILON * time.abs()
}

/// `sin(2 pi f t)`: `frequency` f in Hz, `time` t in s.
pub fn sine(frequency: f64, time: f64) -> f64 {
    libm::sin(2.0 * PI * frequency * time)
}

/// `sign(sin(2 pi f t))`, odd in time, with `square(f, 0) = 0`: `frequency` f in Hz, `time` t in s.
///
/// At a jump, the value before it (seen from t = 0) still applies. This is also what the rounding of
/// `sin` gives at multiples of 1 ms, but independent of the last bit of `time`.
pub fn square(frequency: f64, time: f64) -> f64 {
    let half_periods = 2.0 * frequency * time.abs();
    let band = 2.0 * frequency * tolerance(time);
    if half_periods <= band {
        return 0.0;
    }
    let passed_jumps = libm::ceil(half_periods - band) - 1.0;
    let sign = if passed_jumps % 2.0 == 0.0 { 1.0 } else { -1.0 };
    libm::copysign(sign, sign * time)
}

/// The half period of the square wave that begins at `time` (s) or goes on there: even ones are positive.
fn half_period(frequency: f64, time: f64) -> f64 {
    libm::floor(2.0 * frequency * (time + tolerance(time)))
}

/// As [`square`], but at a jump the value after it.
pub fn square_after(frequency: f64, time: f64) -> f64 {
    match half_period(frequency, time) % 2.0 {
        _ if frequency == 0.0 => 0.0,
        0.0 => 1.0,
        _ => -1.0,
    }
}

/// The time of the first jump of the square wave after `time` (s); infinite for the frequency 0.
pub fn next_jump(frequency: f64, time: f64) -> f64 {
    match frequency {
        0.0 => f64::INFINITY,
        _ => (half_period(frequency, time) + 1.0) / (2.0 * frequency),
    }
}

/// 1 for `start <= time < start + duration` (s), else 0.
pub fn pulse(start: f64, duration: f64, time: f64) -> f64 {
    let since = time - start + tolerance(time);
    if (0.0..duration).contains(&since) { 1.0 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn square_jumps_with_the_sampled_sine_despite_rounding_of_time() {
        assert_eq!(square(0.1, 0.0), 0.0);
        for (jump, before) in [(5.0, 1.0), (10.0, -1.0), (15.0, 1.0), (20.0, -1.0)] {
            let sampled = libm::sin(2.0 * PI * 0.1 * jump);
            assert_eq!(libm::copysign(1.0, sampled), before);
            for drift in [-1e-11, 0.0, 1e-11] {
                assert_eq!(square(0.1, jump + drift), before, "t = {jump} + {drift}");
            }
            assert_eq!(square(0.1, jump + 0.001), -before);
            assert_eq!(square(0.1, -jump), -before);
        }
    }

    #[test]
    fn the_wave_has_the_value_after_each_jump_until_the_next() {
        for (f, start) in [(0.1, 0.0), (3.0, -7.25), (1e6, 1e3)] {
            let mut time = start;
            for _ in 0..1000 {
                let next = next_jump(f, time);
                let length = next - time;
                assert!(length > 0.0 && length <= 0.5 / f + 1e-9, "{time} {next}");
                let expected = square(f, 0.5 * (time + next));
                assert_eq!(square_after(f, time), expected, "{time}");
                assert_eq!(square_after(f, next), -expected, "{next}");
                time = next;
            }
        }
        assert_eq!((square_after(0.0, 1.0), next_jump(0.0, 1.0)), (0.0, f64::INFINITY));
    }

    #[test]
    fn pulse_includes_its_start_but_not_its_end_despite_rounding_of_time() {
        for drift in [-1e-11, 0.0, 1e-11] {
            assert_eq!(pulse(5.0, 0.5, 4.999 + drift), 0.0);
            assert_eq!(pulse(5.0, 0.5, 5.0 + drift), 1.0);
            assert_eq!(pulse(5.0, 0.5, 5.499 + drift), 1.0);
            assert_eq!(pulse(5.0, 0.5, 5.5 + drift), 0.0);
        }
        assert_eq!(pulse(5.0, 0.0, 5.0), 0.0);
    }
}
