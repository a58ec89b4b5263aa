//! What a person says of a file, and what its name seems to say.

use crate::analysis::ids::PlantId;
use crate::analysis::{Code, Problem};
use crate::exchange::{Options, options};
use serde_json::{Map, Value};

/// The signals that a column may be taken for, with what each is.
pub(super) const SIGNALS: [(&str, &str); 5] =
    [("t", "time"), ("r", "command"), ("u", "control"), ("y", "output"), ("d", "disturbance")];

/// The fields of a file in the form, in their order.
const FIELDS: [&str; 13] =
    ["take", "subject", "group", "plant", "number", "session", "t", "r", "u", "y", "d", "time_unit", "sample_time_s"];

/// Characters of a field that are kept.
const MOST: usize = 300;

/// What was filled in for a file.
#[derive(Debug, Clone, Default)]
pub(super) struct Settings(Map<String, Value>);

impl Settings {
    pub(super) fn of(kept: &Map<String, Value>) -> Self {
        Self(kept.clone())
    }

    /// The fields of the file at a place, from a form.
    pub(super) fn read(position: usize, pairs: &[(String, String)]) -> Option<Map<String, Value>> {
        let prefix = format!("{position}.");
        let own: Vec<(&str, &str)> = pairs
            .iter()
            .filter_map(|(name, text)| Some((name.strip_prefix(&prefix)?, text.trim())))
            .filter(|(name, _)| FIELDS.contains(name) || *name == "resample")
            .collect();
        if own.is_empty() {
            return None;
        }
        let mut kept: Map<String, Value> = own
            .into_iter()
            .map(|(name, text)| (name.to_owned(), text.chars().take(MOST).collect::<String>().into()))
            .collect();
        // A box that is not ticked is not sent.
        kept.entry("take").or_insert("no".into());
        Some(kept)
    }

    /// What was filled in.
    pub(super) fn text(&self, name: &str) -> Option<&str> {
        self.0.get(name)?.as_str().filter(|text| !text.is_empty())
    }

    /// Whether the trial is to be stored; nobody has said so of a file that just came.
    pub(super) fn takes(&self) -> Option<bool> {
        self.text("take").map(|text| text == "yes")
    }

    pub(super) fn plant(&self) -> Option<PlantId> {
        self.text("plant")?.parse().ok()
    }

    /// A number of the form.
    pub(super) fn integer(&self, name: &'static str, least: i64) -> Result<Option<i64>, Problem> {
        let Some(text) = self.text(name) else { return Ok(None) };
        let bad = || {
            Problem::new(Code::Invalid, "no such number", format!("'{text}' is no whole number from {least}"))
                .at(format!("field {name}"))
                .mend("Write a whole number, or leave the field empty.")
        };
        let value: i64 = text.parse().map_err(|_| bad())?;
        if (least..=1_000_000_000).contains(&value) { Ok(Some(value)) } else { Err(bad()) }
    }

    /// How the file is read.
    pub(super) fn options(&self) -> Result<Options, Problem> {
        let pairs: Vec<String> =
            SIGNALS.iter().filter_map(|(signal, _)| Some(format!("{signal}:{}", self.text(signal)?))).collect();
        let bad = |name: &str, why: String| {
            Problem::new(Code::Invalid, "cannot be read so", why)
                .at(format!("field {name}"))
                .mend("Change the field, or leave it empty.")
        };
        let columns = if pairs.is_empty() { None } else { Some(pairs.join(",")) };
        let columns = columns.map(|text| options::columns(&text)).transpose().map_err(|why| bad("columns", why))?;
        let time_unit = self.text("time_unit").map(str::parse).transpose().map_err(|why| bad("time unit", why))?;
        let resample = self.text("resample").map(str::parse).transpose().map_err(|why| bad("resample", why))?;
        let sample_time_s = match self.text("sample_time_s").map(str::parse::<f64>) {
            None => None,
            Some(Ok(value)) if value > 0.0 && value.is_finite() => Some(value),
            Some(_) => return Err(bad("sample time", "the sample time is no positive number of seconds".to_owned())),
        };
        Ok(Options { columns: columns.unwrap_or_default(), time_unit, sample_time_s, resample, ..Options::default() })
    }
}

/// What a file's name seems to say.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Guess {
    pub(super) subject: Option<String>,
    pub(super) number: Option<i64>,
    pub(super) session: Option<i64>,
}

/// Digits of a number in a name; longer ones are dates.
const MOST_DIGITS: usize = 5;

impl Guess {
    /// From the name of a file, among people who are known: `S03_t12.csv`, `sub-07_ses-2_run-04.tsv`, `MP01/trial
    /// 5.mat`.
    pub(super) fn of(name: &str, codes: &[String]) -> Self {
        let lower = name.to_lowercase();
        let known = codes.iter().filter(|code| lower.contains(&code.to_lowercase())).max_by_key(|code| code.len());
        let stem = lower.split('.').next().unwrap_or_default();
        let words: Vec<&str> = stem.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
        let mut guess = Self { subject: known.cloned(), ..Self::default() };
        let mut before = "";
        for (at, word) in words.iter().enumerate() {
            let letters = word.trim_end_matches(|c: char| c.is_ascii_digit());
            let digits = &word[letters.len()..];
            // A label and its number may be one word or two.
            let label = if letters.is_empty() { before } else { letters };
            // Numbers behind numbers are a date.
            let is_alone = letters.is_empty() && !before.chars().all(|c| c.is_ascii_digit());
            before = word;
            let is_person = known.is_some_and(|code| code.to_lowercase().contains(*word));
            let Some(number) = digits.parse::<i64>().ok().filter(|n| *n > 0 && digits.len() <= MOST_DIGITS) else {
                continue;
            };
            match label {
                "ses" | "session" | "day" => guess.session = Some(number),
                "t" | "trial" | "run" | "tr" | "take" => guess.number = Some(number),
                _ if is_person => {}
                "sub" | "subject" | "s" | "p" | "participant" if guess.subject.is_none() => {
                    guess.subject = Some(digits_of(name, word));
                }
                // The first word is somebody, the last one a trial.
                _ if guess.subject.is_none() && at == 0 && !letters.is_empty() => {
                    guess.subject = Some(digits_of(name, word));
                }
                _ if is_alone && at > 0 && at + 1 == words.len() => guess.number = guess.number.or(Some(number)),
                _ => {}
            }
        }
        guess
    }
}

/// The word as the name has it, with its capitals.
fn digits_of(name: &str, word: &str) -> String {
    let at = name.to_lowercase().find(word);
    at.and_then(|at| name.get(at..at + word.len())).unwrap_or(word).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_say_whose_and_which() {
        let codes = ["MP01".to_owned(), "MP010".to_owned()];
        let of = |name: &str| {
            let guess = Guess::of(name, &codes);
            (guess.subject, guess.number, guess.session)
        };
        assert_eq!(of("S03_t12.csv"), (Some("S03".to_owned()), Some(12), None));
        assert_eq!(of("mp01/trial 5.mat"), (Some("MP01".to_owned()), Some(5), None));
        assert_eq!(of("mp010-7.csv.gz"), (Some("MP010".to_owned()), Some(7), None));
        assert_eq!(of("sub-07_ses-2_run-04_motion.tsv"), (Some("07".to_owned()), Some(4), Some(2)));
        assert_eq!(of("recording 2024-11-30.csv"), (None, None, None));
        assert_eq!(of("x.csv"), (None, None, None));
    }

    #[test]
    fn a_form_is_read_file_by_file() {
        let pair = |name: &str, text: &str| (name.to_owned(), text.to_owned());
        let pairs = [
            pair("0.take", "yes"),
            pair("0.u", " Stick "),
            pair("0.time_unit", "ms"),
            pair("1.subject", "A"),
            pair("1.evil", "x"),
        ];
        let first = Settings(Settings::read(0, &pairs).unwrap());
        assert_eq!((first.takes(), first.text("u")), (Some(true), Some("Stick")));
        let options = first.options().unwrap();
        assert_eq!(options.columns.control.as_deref(), Some("Stick"));
        let second = Settings(Settings::read(1, &pairs).unwrap());
        assert_eq!((second.takes(), second.text("evil")), (Some(false), None));
        assert!(Settings::read(2, &pairs).is_none());
        let bad = |name: &str, text: &str| Settings(Map::from_iter([(name.to_owned(), text.into())]));
        let place = |problem: Problem| problem.location.unwrap_or_default();
        assert_eq!(place(bad("sample_time_s", "-1").options().unwrap_err()), "field sample time");
        assert_eq!(place(bad("time_unit", "min").options().unwrap_err()), "field time unit");
        assert_eq!(place(bad("number", "0").integer("number", 1).unwrap_err()), "field number");
        assert_eq!(bad("number", "7").integer("number", 1).unwrap(), Some(7));
    }
}
