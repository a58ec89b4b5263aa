//! Fits with one of the controllers held at zero, beside the fit of both.

use super::refined::problem_of;
use super::restricted_fit::RestrictedFit;
use super::spec::CheckedSpec;
use crate::analysis::contract::Failure;
use crate::control::System;
use crate::ctl::{Ctl, Stopped};
use crate::identify::held::{Fitted, Held, restriction_f};
use crate::identify::identifiability::Structure;
use crate::identify::refine::{RefineError, Refinement, Setup, Start};
use crate::identify::search::{Automatic, PreparedPools};
use crate::identify::ssid::{Identified, Settings, SsidError, identify};
use crate::response::FrequencyData;

/// What the restricted fits are made of, and compared with.
pub(super) struct Comparison<'a> {
    pub spec: &'a CheckedSpec,
    pub plant: &'a System,
    pub data: &'a FrequencyData,
    pub settings: &'a Settings,
    pub full: &'a Identified,
    /// J of the refined fit of both controllers.
    pub refined_cost: Option<f64>,
    pub pools: &'a dyn PreparedPools,
}

impl Comparison<'_> {
    /// Fits with each of the controllers that the spec names held at zero.
    pub(super) fn fits(&self, ctl: &Ctl) -> Result<Vec<RestrictedFit>, Failure> {
        let held = &self.spec.restrictions;
        let share = 1.0 / held.len().max(1) as f64;
        let fit = |held: &Held| {
            let _one_of_them = ctl.scope(share);
            self.fit(*held, ctl)
        };
        held.iter().map(fit).collect()
    }

    fn fit(&self, held: Held, ctl: &Ctl) -> Result<RestrictedFit, Failure> {
        let recipe = self.settings.recipe.clone().holding(held);
        let structure = recipe.structure();
        let unknowns = structure.unknowns();
        let settings = Settings { recipe, ..self.settings.clone() };
        let search = Automatic { method: self.spec.search, pools: self.pools };
        let mut row = RestrictedFit {
            held_at_zero: held,
            unknowns,
            pool_size: None,
            cost: None,
            f: None,
            f_reason: None,
            refined_cost: None,
            refined_f: None,
            refined_f_reason: None,
        };
        let found = match identify(self.plant, self.data, &settings, &search, ctl) {
            Err(SsidError::Stopped(stopped)) => return Err(Failure::Stopped(stopped)),
            // The incumbent of one fit of several is no answer.
            Err(SsidError::Interrupted(interrupted)) => return Err(Failure::Stopped(interrupted.stopped)),
            Err(error) => {
                row.f_reason = Some(error.to_string());
                row.refined_f_reason = Some(error.to_string());
                return Ok(row);
            }
            Ok(found) => found,
        };
        let full = &self.full.identifiability;
        let statistic = |full_cost: f64, cost: f64| {
            let fitted = |cost: f64, unknowns: usize| Fitted { cost, unknowns };
            let (both, one) = (fitted(full_cost, full.unknowns), fitted(cost, unknowns));
            restriction_f(both, one, full.equations, self.full.rounding)
        };
        row.pool_size = Some(found.pool_size);
        row.cost = Some(found.optimum.cost);
        match statistic(self.full.optimum.cost, found.optimum.cost) {
            Ok(f) => row.f = Some(f),
            Err(why) => row.f_reason = Some(why.to_string()),
        }
        let refined = if self.spec.refine {
            refined_cost(&found, structure, ctl).map_err(Failure::Stopped)?
        } else {
            Err("the spec asks for no refinement".to_owned())
        };
        row.refined_cost = refined.as_ref().ok().copied();
        let refined_f = match (self.refined_cost, refined) {
            (Some(both), Ok(one)) => statistic(both, one).map_err(|why| why.to_string()),
            (None, Ok(_)) => Err("there is no refined fit of both controllers".to_owned()),
            (_, Err(reason)) => Err(reason),
        };
        match refined_f {
            Ok(f) => row.refined_f = Some(f),
            Err(reason) => row.refined_f_reason = Some(reason),
        }
        Ok(row)
    }
}

/// J, refined from the best candidate; the text says why there is none.
fn refined_cost(found: &Identified, structure: Structure, ctl: &Ctl) -> Result<Result<f64, String>, Stopped> {
    let problem = match problem_of(found, structure) {
        Ok(problem) => problem,
        Err(reason) => return Ok(Err(reason)),
    };
    let setup = Setup { problem: &problem, plant: &found.plant, structure, margin_per_s: found.stability_margin };
    let start = Start::of(&found.feedforward, &found.feedback);
    match Refinement::new(setup, &start, ctl).and_then(|refinement| refinement.refined()) {
        Ok(refined) => Ok(Ok(refined.cost)),
        Err(RefineError::Stopped(stopped)) => Err(stopped),
        Err(error) => Ok(Err(error.to_string())),
    }
}
