//! What one step of each controller and of the plant costs in process, in the form of
//! `bench/cycle.c`: one JSON object per line. `cargo bench --package control -- [CYCLES REPEATS]`.

use std::hint::black_box;
use std::time::Instant;

use control::pid::{Gains, Integral};
use control::plant::{Linear, Parameters, State};
use control::{IpidRbf, Pid, PidRbf};

const TS: f64 = 0.001;
const PERIOD: usize = 64;

/// Values that differ from one cycle to the next, of mean zero, as in `bench/cycle.c`.
fn signal() -> [f64; PERIOD] {
    let mut state = 1u32;
    let mut signal = [0.0; PERIOD];
    for pair in signal.chunks_mut(2) {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        pair[0] = 0.01 + 0.1 * f64::from(state >> 8) / f64::from(1 << 24);
        pair[1] = -pair[0];
    }
    signal
}

/// Measures a step, which is given the number of its cycle's first signal; every repeat begins with
/// a copy of `start`.
fn measure<S: Clone>(
    name: &str,
    (cycles, repeats): (usize, usize),
    start: &S,
    step: impl Fn(&mut S, [f64; 2]) -> f64,
) {
    let signal = signal();
    let mut times: Vec<f64> = (0..repeats)
        .map(|_| {
            let mut system = black_box(start.clone());
            let mut run = |first: usize, last: usize| {
                for k in first..last {
                    let inputs = [signal[k % PERIOD], signal[(k + 1) % PERIOD]];
                    black_box(step(black_box(&mut system), inputs));
                }
            };
            let warm = cycles / 8 + 1;
            run(0, warm);
            let begin = Instant::now();
            run(warm, warm + cycles);
            begin.elapsed().as_secs_f64() * 1e9 / cycles as f64
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!(
        "{{\"model\": \"{name}\", \"mode\": \"in_process\", \"cycles\": {cycles}, \
         \"repeats\": {repeats}, \"min_ns\": {:.3}, \"median_ns\": {:.3}}}",
        times[0],
        f64::midpoint(times[(repeats - 1) / 2], times[repeats / 2])
    );
}

fn pid(integral: Integral) -> Pid {
    let mut pid = Pid::new(integral);
    pid.gains = Gains {
        kp: 300.0,
        ki: 500.0,
        kd: 100.0,
    };
    pid.ts = TS;
    pid.u_max = 1e9;
    pid
}

fn learning(integral: Integral) -> PidRbf<4> {
    let mut law = PidRbf {
        pid: pid(integral),
        ..PidRbf::default()
    };
    law.network.centres = [-2.0, -1.0, 1.0, 2.0];
    law.network.widths = [0.5; 4];
    law.network.eta = 0.3;
    law.network.alpha = 0.05;
    law
}

fn main() {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let size = match numbers[..] {
        [cycles, repeats] => (cycles, repeats),
        _ => (20_000, 100),
    };
    measure("Pid", size, &pid(Integral::Sum), |pid, [y, d]| {
        pid.sample(1.0, y, d)
    });
    measure("PidRbf", size, &learning(Integral::Sum), |law, [y, d]| {
        law.sample(1.0, y, d)
    });
    let ipid = IpidRbf {
        law: learning(Integral::Leaky),
        ..IpidRbf::default()
    };
    measure("IpidRbf", size, &ipid, |controller, [y, d]| {
        controller.sample(1.0, y, d, 0.0)
    });
    let plant = (Linear::new(&Parameters::PAPER), State::default());
    measure("Pendulum", size, &plant, |(plant, state), [u, _]| {
        plant.advance(state, u, TS);
        state.theta
    });
}
