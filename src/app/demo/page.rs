//! The story as a page of its own: no script, nothing fetched.

use super::story::{GroupStory, NormTable, Point, Story};
use super::tables::{end, number};
use std::fmt::Write as _;

/// Width and height of a figure, and what its axes take of it.
const SIZE: [f64; 2] = [420.0, 240.0];
const MARGIN: f64 = 40.0;
/// How far the people of one trial stand apart, in pixels.
const APART: f64 = 7.0;

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;\
color:#1a1a1a;background:#fff}table{border-collapse:collapse;margin:.5rem 0 1rem}th,td{padding:.25rem .75rem;\
text-align:left;border-bottom:1px solid #ddd}caption{text-align:left;font-weight:600}td.n{font-variant-numeric:\
tabular-nums}pre{background:#f4f4f4;padding:.75rem;overflow-x:auto}svg{max-width:100%;height:auto}";

/// Text in an element.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The whole page.
#[must_use]
pub fn page(story: &Story) -> String {
    let paragraphs = |all: &[String]| all.iter().map(|text| format!("<p>{}</p>", escaped(text))).collect::<String>();
    let items = |all: &[String]| all.iter().map(|text| format!("<li>{}</li>", escaped(text))).collect::<String>();
    let groups: String = story.groups.iter().map(group).collect();
    let next: Vec<String> = story.next.iter().map(|command| escaped(command)).collect();
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\"><title>Volition: a demonstration</title>\
         <style>{STYLE}</style></head><body><h1>Who learned what: simulated people, whose truth is known</h1>\
         {}{groups}<h2>What this teaches</h2><ul>{}{}</ul><h2>Next</h2><pre>{}</pre></body></html>\n",
        paragraphs(&story.heading),
        items(&story.lessons),
        items(&story.findings),
        next.join("\n")
    )
}

fn group(group: &GroupStory) -> String {
    let tables: String = group.tables.iter().map(|table| format!("{}{}", self::table(table), figure(table))).collect();
    format!("<h2>{} on {}, {} people</h2>{tables}", escaped(&group.name), escaped(&group.plant), group.people)
}

fn table(table: &NormTable) -> String {
    let mut rows = String::new();
    for row in &table.rows {
        let [first, last] = &row.ends;
        let _ = write!(
            rows,
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td>{}</td></tr>",
            escaped(row.title),
            escaped(row.stimuli),
            end(first),
            end(last),
            escaped(&row.trust())
        );
    }
    let [first, last] = table.truth.map(|value| value.map_or_else(|| "–".to_owned(), number));
    format!(
        "<table><caption>{}: {}</caption><thead><tr><th>estimator</th><th>stimuli</th><th>first trial</th>\
         <th>last trial</th><th>trust</th></tr></thead><tbody>{rows}<tr><td>truth</td><td></td>\
         <td class=\"n\">{first}</td><td class=\"n\">{last}</td><td></td></tr></tbody></table>",
        table.symbol, table.meaning
    )
}

/// Every person's trials with their intervals, and the truth, by the last way of the table.
fn figure(table: &NormTable) -> String {
    let mut trials: Vec<i64> = table.points.iter().map(|point| point.trial).collect();
    trials.sort_unstable();
    trials.dedup();
    let top = table
        .points
        .iter()
        .map(|point| point.truth.max(point.interval.map_or(point.value, |[_, high]| high)))
        .fold(0.0, f64::max);
    if trials.is_empty() || top <= 0.0 {
        return String::new();
    }
    let [width, height] = SIZE;
    let down = |value: f64| height - MARGIN - (height - 1.5 * MARGIN) * (value / top).clamp(0.0, 1.0);
    let column = |trial: i64| {
        let at = trials.iter().position(|other| *other == trial).unwrap_or(0);
        MARGIN + (width - 1.5 * MARGIN) * (at as f64 + 0.5) / trials.len() as f64
    };
    let mut marks = String::new();
    for trial in &trials {
        let people: Vec<&Point> = table.points.iter().filter(|point| point.trial == *trial).collect();
        for (at, point) in people.iter().enumerate() {
            let x = column(*trial) + APART * (at as f64 - 0.5 * (people.len() - 1) as f64);
            if let Some([low, high]) = point.interval {
                let (low, high) = (down(low), down(high));
                let _ = write!(
                    marks,
                    "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{low:.1}\" y2=\"{high:.1}\" stroke=\"#0072b2\"/>"
                );
            }
            let (own, truth) = (down(point.value), down(point.truth));
            let _ = write!(
                marks,
                "<circle cx=\"{x:.1}\" cy=\"{own:.1}\" r=\"2.5\" fill=\"#0072b2\"/>\
                 <line x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{truth:.1}\" y2=\"{truth:.1}\" stroke=\"#d55e00\" \
                 stroke-width=\"2\"/>",
                x - 3.0,
                x + 3.0
            );
        }
        let _ = write!(
            marks,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-size=\"12\">{trial}</text>",
            column(*trial),
            height - MARGIN + 16.0
        );
    }
    let (floor, ceiling, left) = (down(0.0), down(top), MARGIN);
    format!(
        "<figure><svg viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" role=\"img\" \
         aria-label=\"{symbol} of every person and trial with 95 % intervals, beside the truth\">\
         <path d=\"M{left} {ceiling:.1}V{floor:.1}H{:.1}\" fill=\"none\" stroke=\"#555\"/>\
         <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" font-size=\"12\">0</text>\
         <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\" font-size=\"12\">{}</text>\
         <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-size=\"12\">trial</text>{marks}</svg>\
         <figcaption>{symbol} by prediction error with two stimuli: points with 95 % intervals, one a person; dashes \
         are the truth.</figcaption></figure>",
        width - 0.5 * MARGIN,
        left - 4.0,
        floor + 4.0,
        left - 4.0,
        ceiling + 4.0,
        number(top),
        0.5 * width,
        height - 6.0,
        symbol = table.symbol,
    )
}
