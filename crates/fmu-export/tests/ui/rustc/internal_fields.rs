//! Internal fields of types that lack a trait, which the message names.

use fmu_export::prelude::*;
use serde::{Deserialize, Serialize};

#[derive(Clone, Serialize, Deserialize)]
struct WithoutDefault;

#[derive(Default, Serialize, Deserialize)]
struct WithoutClone;

#[derive(Clone, Default)]
struct WithoutSerde;

#[derive(Clone, Default, Serialize)]
struct WithoutDeserialize;

struct Bare;

#[derive(Variables)]
struct Internal {
    without_default: WithoutDefault,
    without_clone: WithoutClone,
    without_clones: [WithoutClone; 2],
    without_serde: WithoutSerde,
    without_deserialize: [WithoutDeserialize; 40],
    // The ways out.
    optional: Option<WithoutDefault>,
    #[fresh(WithoutDefault)] fresh: WithoutDefault,
    #[copied] copied: WithoutSerde,
    #[saved(with = bare)] #[fresh(Bare)] saved: Bare,
    #[unsaved] #[fresh([Bare, Bare])] unsaved: [Bare; 2],
}

mod bare {
    pub fn save(_: &super::Bare) {}

    pub fn load((): ()) -> super::Bare {
        super::Bare
    }
}

#[derive(Variables)]
struct Others {
    #[fresh("text")] another_type: f64,
    #[copied] still_without_clone: Option<WithoutClone>,
    #[unsaved] still_without_default: WithoutDefault,
    #[saved(with = elsewhere)] without_module: f64,
}

fn main() {}
