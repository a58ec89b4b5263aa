//! Texts that are no table of samples, known by a line of theirs, and what to do about them.

use crate::analysis::{Code, Problem};

/// So many lines are looked at.
const LINES: usize = 200;

/// A text that is not read: what one of its lines begins with, what it is, and what to do.
const TEXTS: [(&str, &str, &str); 8] = [
    (
        "\"CHANNEL\"\t",
        "Spike2's text of one channel after another",
        "In Spike2, export as spreadsheet text, which has a column for each channel.",
    ),
    (
        "*** Header Start ***",
        "a log of events of E-Prime",
        "Send the samples that the script wrote at every frame, as a table.",
    ),
    ("Logfile written", "a log of events of Presentation", "Send the samples that the scenario wrote, as a table."),
    (
        "Brain Vision Data Exchange Header File",
        "the header of a BrainVision recording, and the samples stand in another file",
        "Export the recording as text, such as mne.io.read_raw_brainvision(FILE).to_data_frame().to_csv('trial.csv').",
    ),
    ("<?xml", "XML", "Export the samples as a table (CSV)."),
    ("<html", "a web page, as some programs write for Excel", "Open it in a spreadsheet and save it as CSV."),
    ("<!DOCTYPE html", "a web page", "Open it in a spreadsheet and save it as CSV."),
    ("<table", "a web page, as some programs write for Excel", "Open it in a spreadsheet and save it as CSV."),
];

/// The refusal of a text that is no table.
pub(super) fn refuse(head: &str) -> Option<Problem> {
    for (at, line) in head.lines().take(LINES).enumerate() {
        let line = line.trim();
        let known = TEXTS.iter().find(|(start, ..)| {
            line.get(..start.trim_end().len()).is_some_and(|own| own.eq_ignore_ascii_case(start.trim_end()))
        });
        if let Some((_, what, mend)) = known {
            return Some(not_read(at, what, mend));
        }
        if is_scale(line) {
            let what = format!("what MATLAB shows: {line:?} stands before numbers that are all to be multiplied by it");
            return Some(not_read(at, &what, "In MATLAB, write it: writematrix([t r u y], 'trial.csv')."));
        }
    }
    if let Some(at) = labelled(head) {
        let mend = "Write the numbers alone, under one line of names: sed -E 's/[A-Za-z_ ]+[:=] *//g' FILE.";
        return Some(not_read(at, "labels beside numbers, as for the plotter of the Arduino", mend));
    }
    let first = head.lines().next().unwrap_or_default();
    if let Some((stamp, _)) = first.split_once(" -> ")
        && stamp.split(':').count() == 3
        && stamp.bytes().all(|byte| byte.is_ascii_digit() || b":. ".contains(&byte))
    {
        let mend = "Take the clock out, which is that of the screen: sed 's/^.* -> //' FILE, and give the sample time.";
        return Some(not_read(0, "what the Arduino's monitor shows, with its clock before each line", mend));
    }
    let start = head.trim_start();
    if let Some(rest) = start.strip_prefix('[')
        && rest.trim_start().starts_with(['{', '['])
    {
        let mend = "Make one document of it: jq '{sample_time_s: 0.01, r: map(.r), u: map(.u), y: map(.y)}' FILE.";
        return Some(not_read(0, "a JSON list, and a trial is one object with a list for each signal", mend));
    }
    None
}

/// The first line, from 0, where all that there are have a label before each number, and nothing between the two.
fn labelled(head: &str) -> Option<usize> {
    let is_number = |text: &str| text.parse::<f64>().is_ok();
    let is_pair = |cell: &str| {
        cell.split_once([':', '='])
            .is_some_and(|(label, value)| label.trim().starts_with(char::is_alphabetic) && is_number(value.trim()))
    };
    let is_labelled = |line: &str| {
        [',', '\t', ' ', ';'].into_iter().any(|between| {
            let cells: Vec<&str> = line.split(between).map(str::trim).filter(|cell| !cell.is_empty()).collect();
            cells.len() >= 3 && cells.iter().all(|cell| is_pair(cell))
        })
    };
    let mut lines = head.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).take(3);
    let (first, _) = lines.clone().next()?;
    (lines.clone().count() == 3 && lines.all(|(_, line)| is_labelled(line))).then_some(first)
}

fn not_read(line: usize, what: &str, mend: &str) -> Problem {
    Problem::new(Code::Malformed, "a format that is not read", format!("the file is {what}"))
        .at(format!("row {}", line + 1))
        .mend(mend)
}

/// Whether a line is a common factor, as MATLAB shows it: `1.0e+03 *`.
fn is_scale(line: &str) -> bool {
    line.strip_suffix('*').is_some_and(|factor| {
        let factor = factor.trim();
        factor.starts_with("1.0e") && factor.parse::<f64>().is_ok()
    })
}
