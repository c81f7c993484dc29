use fmu_export::prelude::*;

/// Three tanks that drain into each other, a model with an array of structs and a log
#[derive(Model)]
#[model(continuous, stop_time = 20, step_size = 0.1)]
pub struct Cascade {
    /// Flow into the first tank
    #[input(start = 1, min = 0, unit = "m3/s")]
    inflow: f64,
    /// Flow out of the last tank
    #[output(unit = "m3/s")]
    outflow: f64,
    #[nested]
    tank: [Tank; 3], // tank[1].level, tank[1].area, ..., tank[3].rest
    #[log]
    log: Log,
}

#[derive(Variables)]
struct Tank {
    /// Level
    #[output(state, unit = "m")]
    level: f64,
    #[derivative(of = level)]
    level_rate: f64,
    /// Area
    #[parameter(start = 2, min = 0.1, unit = "m2")]
    area: f64,
    /// Flow out of the tank per level
    #[parameter(start = 1, min = 0, unit = "m2/s")]
    outlet: f64,
    /// Level at which the tank is full
    #[parameter(tunable, start = 0.8, min = 0, unit = "m")]
    height: f64,
    /// Level that is left until it is full
    #[event_indicator(unit = "m")]
    rest: f64,
    is_full: bool,
}

impl Continuous for Cascade {
    fn evaluate(&mut self, _time: f64) -> Result<(), ModelError> {
        let mut flow = self.inflow;
        for tank in &mut self.tank {
            let out = tank.outlet * tank.level;
            tank.level_rate = (flow - out) / tank.area;
            tank.rest = tank.height - tank.level;
            flow = out;
        }
        self.outflow = flow;
        Ok(())
    }

    fn event(&mut self, time: f64) -> Result<(), ModelError> {
        for (tank, number) in self.tank.iter_mut().zip(1..) {
            let is_full = tank.level >= tank.height;
            if is_full && !tank.is_full {
                self.log.warning(format_args!("at t = {time:.3} s: tank {number} is full"));
            }
            tank.is_full = is_full;
        }
        self.log.info(format_args!("at t = {time:.3} s: an event was handled"));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use fmu_export::testing::Driver;

    use super::*;

    #[test]
    fn each_tank_says_once_that_it_is_full() -> Result<(), ModelError> {
        let mut cascade = Driver::<Cascade>::new();
        cascade.set("tank[3].height", 5.0)?;
        cascade.run(20.0, 0.1)?;
        let messages = cascade.messages().into_iter();
        let warnings = messages.filter(|message| message.category == "logStatusWarning");
        let texts: Vec<_> = warnings.map(|message| message.text).collect();
        assert_eq!(texts.len(), 2, "{texts:?}");
        // The first one follows from 1 - exp(-t / 2) = 0.8.
        assert_eq!(texts[0], "at t = 3.219 s: tank 1 is full");
        assert!(texts[1].ends_with("tank 2 is full"));
        Ok(())
    }
}
