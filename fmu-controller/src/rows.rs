//! Rows shared by the variable tables of the controllers. Each macro builds a table from its own rows
//! and the given ones; `$pid` and `$law` are the fields of the model with a `pendulum_control::Pid` and a
//! `pendulum_control::PidRbf`.

/// The signals and parameters of a PID.
macro_rules! pid_rows {
    ($Row:ident, [$($pid:ident).+], u = [$($u:ident).+], [$($row:expr),* $(,)?]) => {
        &[
            $Row::input("r", |m| &mut m.r).unit(RADIAN).about("set-point of the angle"),
            $Row::input("y", |m| &mut m.y).unit(RADIAN).about("measured angle"),
            $Row::input("d", |m| &mut m.d)
                .unit(RADIAN)
                .about("disturbance, added to the measured angle"),
            $Row::output("u", |m| &mut m.$($u).+).unit(NEWTON).discrete().about("force on the cart"),
            $Row::output("u_p", |m| &mut m.$($pid).+.u_p)
                .unit(NEWTON)
                .discrete()
                .about("the PID's part of the force, not limited"),
            $Row::output("e", |m| &mut m.$($pid).+.e)
                .unit(RADIAN)
                .discrete()
                .about("control error r - (y + d)"),
            $Row::tunable("pid.kp", 300.0, |m| &mut m.$($pid).+.gains.kp)
                .unit(NEWTON_PER_RADIAN)
                .at_least(0.0)
                .at_most(1e9)
                .about("proportional gain"),
            $Row::tunable("pid.ki", 500.0, |m| &mut m.$($pid).+.gains.ki)
                .unit(NEWTON_PER_RADIAN_SECOND)
                .at_least(0.0)
                .at_most(1e9)
                .about("integral gain"),
            $Row::tunable("pid.kd", 100.0, |m| &mut m.$($pid).+.gains.kd)
                .unit(NEWTON_SECOND_PER_RADIAN)
                .at_least(0.0)
                .at_most(1e9)
                .about("derivative gain"),
            $Row::tunable("u_max", 100.0, |m| &mut m.$($pid).+.u_max)
                .unit(NEWTON)
                .at_least(0.0)
                .at_most(1e9)
                .about("limit of the force, both ways"),
            $Row::fixed("ts", 0.001, |m| &mut m.$($pid).+.ts)
                .unit(SECOND)
                .at_least(1e-6)
                .at_most(1e3)
                .about("sample time"),
            $Row::flag("previous_sample_terms", false, |m| &mut m.$($pid).+.previous_sample_terms)
                .about("whether u(k) is computed from the error's terms of sample k-1"),
            $Row::flag("anti_windup", false, |m| &mut m.$($pid).+.anti_windup)
                .about("whether samples that would drive a limited force further stay out of the error's sum"),
            $($row),*
        ]
    };
}

/// The rows of [`pid_rows`] and those of an RBF network with four nodes.
macro_rules! rbf_rows {
    ($Row:ident, [$($law:ident).+], [$($row:expr),* $(,)?]) => {
        pid_rows!($Row, [$($law).+.pid], u = [$($law).+.u], [
            $Row::output("u_n", |m| &mut m.$($law).+.u_n)
                .unit(NEWTON)
                .discrete()
                .about("the network's part of the force"),
            $Row::output_array("rbf.w", 4, |m| &mut m.$($law).+.network.weights)
                .unit(NEWTON)
                .discrete()
                .initially_from(&["rbf.w0"])
                .about("weight of the node"),
            $Row::output_array("rbf.h", 4, |m| &mut m.$($law).+.network.activations)
                .discrete()
                .about("activation of the node"),
            $Row::tunable("rbf.eta", 0.3, |m| &mut m.$($law).+.network.eta)
                .at_least(0.0)
                .at_most(10.0)
                .about("learning rate"),
            $Row::tunable("rbf.alpha", 0.05, |m| &mut m.$($law).+.network.alpha)
                .at_least(0.0)
                .at_most(1.0)
                .about("momentum factor"),
            $Row::fixed_array("rbf.c", &[-2.0, -1.0, 1.0, 2.0], |m| {
                &mut m.$($law).+.network.centres
            })
                .unit(RADIAN)
                .at_least(-1e9)
                .at_most(1e9)
                .about("centre of the node"),
            $Row::fixed_array("rbf.b", &[0.5; 4], |m| &mut m.$($law).+.network.widths)
                .unit(RADIAN)
                .at_least(1e-6)
                .at_most(1e9)
                .about("width of the node"),
            $Row::fixed_array("rbf.w0", &[0.0; 4], |m| &mut m.w0)
                .unit(NEWTON)
                .at_least(-1e9)
                .at_most(1e9)
                .about("initial weight of the node"),
            $($row),*
        ])
    };
}

pub(crate) use {pid_rows, rbf_rows};
