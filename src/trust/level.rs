//! Levels, and what is said beside them.

use super::judge::LeftOut;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How far a value may be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "TrustLevel")]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// It was never identified.
    NotIdentified,
    /// Nothing speaks against it.
    Ok,
    /// Warnings are to be read first.
    Read,
    /// Not to be used.
    DoNotUse,
}

impl Level {
    /// All of them, from the least grave.
    pub const ALL: [Self; 4] = [Self::NotIdentified, Self::Ok, Self::Read, Self::DoNotUse];

    /// Its name in documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NotIdentified => "not_identified",
            Self::Ok => "ok",
            Self::Read => "read",
            Self::DoNotUse => "do_not_use",
        }
    }

    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::NotIdentified => "not identified",
            Self::Ok => "ok",
            Self::Read => "read the warnings",
            Self::DoNotUse => "do not use",
        }
    }

    /// Its sign, which stands beside the words and never alone.
    #[must_use]
    pub fn sign(self) -> &'static str {
        match self {
            Self::NotIdentified => "·",
            Self::Ok => "✓",
            Self::Read => "!",
            Self::DoNotUse => "✕",
        }
    }
}

/// A row of the rule that applies, beside the gravest one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "TrustReason")]
pub struct Reason {
    /// What the row says of the value.
    pub level: Level,
    /// The row's code, in `snake_case`.
    pub code: String,
    /// The finding, in words and numbers.
    pub because: String,
}

/// How far a quantity may be used, and why no further.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Trust {
    /// The quantity by its name, such as `norm_feedback`; of a fit, a parameter's name.
    pub quantity: String,
    /// The level: the worst of the rows that apply.
    pub level: Level,
    /// The code of the row that decides, in `snake_case`; `ok` or `measured` where nothing speaks against the value.
    pub code: String,
    /// The finding, in words and numbers.
    pub because: String,
    /// What to do about it, in one sentence; empty where there is nothing to do.
    #[serde(rename = "do")]
    pub advice: String,
    /// The other rows that apply, the gravest first.
    pub also: Vec<Reason>,
}

impl Trust {
    /// The same in a trial that is divergent or excluded, or neither: of one that is, nothing is to be used, as far as
    /// there is anything.
    #[must_use]
    pub fn in_trial<'a>(self, trial: impl Into<LeftOut<'a>>) -> Self {
        let reasons = trial.into().reasons();
        if reasons.is_empty() || self.level == Level::NotIdentified {
            return self;
        }
        let own =
            (self.level != Level::Ok).then_some(Reason { level: self.level, code: self.code, because: self.because });
        let found = reasons.into_iter().chain(own).chain(self.also).collect();
        super::judge::worst_of(&self.quantity, found, "ok")
    }

    /// The codes of all rows that apply, the gravest first.
    pub fn codes(&self) -> impl Iterator<Item = &str> {
        std::iter::once(self.code.as_str()).chain(self.also.iter().map(|reason| reason.code.as_str()))
    }
}

/// How far a number that is made of several values may be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "TrustOfMean")]
pub struct MeanTrust {
    /// The worst of its members where more than a third are that bad; else, where some are not to be used, `read`.
    pub level: Level,
    /// How many of its members are not to be used. They are taken in: nothing is left out in silence.
    pub do_not_use: usize,
    /// How many members there are.
    pub of: usize,
}

impl Default for MeanTrust {
    fn default() -> Self {
        Self { level: Level::NotIdentified, do_not_use: 0, of: 0 }
    }
}

/// The trust in a mean over several: their worst level where more than a third are that bad, else no better than to be
/// read where any of them is worse.
#[must_use]
pub fn of_mean(levels: &[Level]) -> MeanTrust {
    let worst = levels.iter().copied().max().unwrap_or(Level::NotIdentified);
    let count = |level: Level| levels.iter().filter(|own| **own == level).count();
    let is_worst = worst <= Level::Read || super::rule::exceeds_share(count(worst), levels.len());
    let level = if is_worst { worst } else { Level::Read };
    MeanTrust { level, do_not_use: count(Level::DoNotUse), of: levels.len() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_is_as_bad_as_more_than_a_third_of_it() {
        use Level::{DoNotUse, NotIdentified, Ok, Read};
        let level = |levels: &[Level]| of_mean(levels).level;
        assert_eq!(level(&[Ok, DoNotUse, Ok]), Read);
        assert_eq!(level(&[Ok, DoNotUse, DoNotUse]), DoNotUse);
        assert_eq!(level(&[Ok, Read, Ok]), Read);
        assert_eq!(level(&[Ok, Ok]), Ok);
        assert_eq!(level(&[]), NotIdentified);
        assert_eq!(of_mean(&[Ok, DoNotUse, Read]), MeanTrust { level: Read, do_not_use: 1, of: 3 });
    }
}
