//! Reading the members of the inputs.

use super::found_by::FoundBy;
use super::written::{OtherController, OtherCost, OtherNoise, Trajectory, WrittenMatrix};
use crate::analysis::kind::Kind;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{self, object, only, wrong_inputs as wrong};
use crate::trial::pointer;
use serde_json::{Map, Value};

/// Where the weights to compare with are.
const OTHER: &str = "/inputs/compare_with";

/// The members of the inputs, all of them known; those that are null count as absent.
pub(in crate::analysis) struct Members<'a> {
    kind: Kind,
    members: &'a Map<String, Value>,
    needed: &'static [&'static str],
}

/// A member that is there and not null.
fn present<'a>(members: &'a Map<String, Value>, name: &str) -> Option<&'a Value> {
    members.get(name).filter(|value| !value.is_null())
}

/// A matrix within a member.
fn part(members: &Map<String, Value>, name: &str, at: &str) -> Result<WrittenMatrix, Problem> {
    let value = present(members, name).ok_or_else(|| wrong(format!("there is no {name}"), at))?;
    WrittenMatrix::read(value, name, &pointer::member(at, name))
}

impl<'a> Members<'a> {
    /// The inputs of a kind; what it takes beside the matrices that it needs may be left out.
    pub(in crate::analysis) fn new(
        value: &'a Value,
        kind: Kind,
        needed: &'static [&'static str],
        own: &[&str],
    ) -> Result<Self, Problem> {
        let members = value.as_object().ok_or_else(|| wrong("the inputs are no object", "/inputs"))?;
        let optional = [&["sample_time_s", "state_names", "state_units", "compare_with", "found_by"], own].concat();
        for name in members.keys() {
            if !needed.contains(&name.as_str()) && !optional.contains(&name.as_str()) {
                let (needed, optional) = (needed.join(", "), optional.join(", "));
                return Err(wrong(format!("{kind} takes no input {name:?}"), pointer::member("/inputs", name))
                    .mend(format!("It takes {needed} and, if wanted, {optional}.")));
            }
        }
        Ok(Self { kind, members, needed })
    }

    /// A matrix that must be there.
    pub(in crate::analysis) fn matrix(&self, name: &str) -> Result<WrittenMatrix, Problem> {
        self.optional_matrix(name)?.ok_or_else(|| {
            let advice = format!("Give {}.", self.needed.join(", "));
            wrong(format!("there is no matrix {name}"), "/inputs").mend(advice)
        })
    }

    /// A matrix that may be left out.
    pub(in crate::analysis) fn optional_matrix(&self, name: &str) -> Result<Option<WrittenMatrix>, Problem> {
        let read = |value| WrittenMatrix::read(value, &name.to_uppercase(), &pointer::member("/inputs", name));
        present(self.members, name).map(read).transpose()
    }

    /// The sample time in seconds; none in continuous time.
    pub(in crate::analysis) fn sample_time_s(&self) -> Result<Option<f64>, Problem> {
        let Some(value) = present(self.members, "sample_time_s") else { return Ok(None) };
        value.as_f64().filter(|t| *t > 0.0 && t.is_finite()).map(Some).ok_or_else(|| {
            wrong(format!("the sample time {value} is no positive number of seconds"), "/inputs/sample_time_s")
                .mend("Give the sample time in seconds, or null for continuous time.")
        })
    }

    /// Names or units.
    pub(in crate::analysis) fn texts(&self, name: &str) -> Result<Option<Vec<String>>, Problem> {
        let read = |value: &Value| {
            serde_json::from_value(value.clone())
                .map_err(|error| wrong(error.to_string(), pointer::member("/inputs", name)))
        };
        present(self.members, name).map(read).transpose()
    }

    /// The analysis that found the gains.
    pub(in crate::analysis) fn found_by(&self) -> Result<Option<FoundBy>, Problem> {
        let read = |value| reading::read(value, "/inputs/found_by", "unusable inputs");
        present(self.members, "found_by").map(read).transpose()
    }

    /// The trajectory.
    pub(in crate::analysis) fn trajectory(&self) -> Result<Option<Trajectory>, Problem> {
        const AT: &str = "/inputs/trajectory";
        let Some(value) = present(self.members, "trajectory") else { return Ok(None) };
        let members = object(value, "the trajectory", AT)?;
        only(members, &["x", "u"], AT)?;
        Ok(Some(Trajectory { x: part(members, "x", AT)?, u: part(members, "u", AT)? }))
    }

    /// `compare_with`, where it is there.
    fn other(&self) -> Result<Option<&'a Map<String, Value>>, Problem> {
        let Some(value) = present(self.members, "compare_with") else { return Ok(None) };
        let members = object(value, "compare_with", OTHER)?;
        only(members, &["q", "r", "w", "v"], OTHER)?;
        Ok(Some(members))
    }

    /// Refuses weights of a half that the kind does not have.
    fn refuse(&self, members: &Map<String, Value>, names: [&str; 2]) -> Result<(), Problem> {
        if names.iter().all(|name| present(members, name).is_none()) {
            return Ok(());
        }
        let detail = format!("{} has no {} to compare with", self.kind, names[0]);
        Err(wrong(detail, pointer::member(OTHER, names[0])))
    }

    /// Another Q and R.
    pub(in crate::analysis) fn other_cost(&self) -> Result<Option<OtherCost>, Problem> {
        let Some(members) = self.other()? else { return Ok(None) };
        self.refuse(members, ["w", "v"])?;
        let [q, r] = pair(members, ["q", "r"])?.ok_or_else(no_weights)?;
        Ok(Some(OtherCost { q, r }))
    }

    /// Another W and V.
    pub(in crate::analysis) fn other_noise(&self) -> Result<Option<OtherNoise>, Problem> {
        let Some(members) = self.other()? else { return Ok(None) };
        self.refuse(members, ["q", "r"])?;
        let [w, v] = pair(members, ["w", "v"])?.ok_or_else(no_weights)?;
        Ok(Some(OtherNoise { w, v }))
    }

    /// Another Q and R, another W and V, or both.
    pub(in crate::analysis) fn other_controller(&self) -> Result<Option<OtherController>, Problem> {
        let Some(members) = self.other()? else { return Ok(None) };
        let (cost, noise) = (pair(members, ["q", "r"])?, pair(members, ["w", "v"])?);
        if cost.is_none() && noise.is_none() {
            return Err(no_weights());
        }
        let [q, r] = cost.map_or([None, None], |pair| pair.map(Some));
        let [w, v] = noise.map_or([None, None], |pair| pair.map(Some));
        Ok(Some(OtherController { q, r, w, v }))
    }
}

/// Both weights of a half; `None` where neither is there.
fn pair(members: &Map<String, Value>, [state, port]: [&str; 2]) -> Result<Option<[WrittenMatrix; 2]>, Problem> {
    if present(members, state).is_none() && present(members, port).is_none() {
        return Ok(None);
    }
    Ok(Some([part(members, state, OTHER)?, part(members, port, OTHER)?]))
}

fn no_weights() -> Problem {
    wrong("there are no weights", OTHER).mend("Give q and r of another regulator, or w and v of another filter.")
}
