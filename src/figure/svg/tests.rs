use super::super::decimate::KEPT;
use super::super::path::tenths;
use super::super::path::tests::read;
use super::*;
use crate::figure::of::signals::signals;
use crate::figure::of::signals::tests::{origin, trial};
use crate::figure::{Axis, Ink, Mark, Panel, RuleKind, Series, Span, Weight};
use roxmltree::{Document, Node};

fn drawing(width: u32, theme: Theme) -> Drawing {
    Drawing { width, theme, from: None, to: None }
}

/// A figure drawn, and the drawing's text.
fn drawn(figure: &Figure, drawing: &Drawing) -> (Figure, String) {
    let seen = figure.drawn(drawing).unwrap();
    let text = write(&seen, drawing);
    (seen, text)
}

fn with_class<'a>(document: &'a Document<'a>, class: &str) -> Vec<Node<'a, 'a>> {
    let has = |node: &Node<'_, '_>| node.attribute("class").is_some_and(|all| all.split(' ').any(|one| one == class));
    document.descendants().filter(has).collect()
}

/// A figure of one series.
fn one(x: Vec<f64>, y: Vec<Option<f64>>) -> Figure {
    let series = Series::values("own", (Mark::Samples, Ink::Output, Weight::Thin), x, y);
    Figure {
        name: "one".into(),
        title: "One".into(),
        description: "One line.".into(),
        caption: "By a test.".into(),
        sampling: String::new(),
        x: Axis { range: Some([0.0, 10.0]), ..Axis::linear("time", "s") },
        panels: vec![Panel::new("", Axis { range: Some([0.0, 1.0]), ..Axis::linear("y", "1") }, vec![series])],
    }
}

/// A known series gives a known path: a frame of 560 by 280 pixels, its ground 5 pixels above that of the plot.
#[test]
fn a_known_series_has_a_known_path() {
    let figure = one(vec![0.0, 2.5, 5.0, 7.5, 10.0], vec![Some(0.0), Some(1.0), None, Some(0.25), Some(0.5)]);
    let (_, text) = drawn(&figure, &drawing(638, Theme::Page));
    let document = Document::parse(&text).unwrap();
    let plot = with_class(&document, "f-plot")[0];
    assert_eq!((plot.attribute("width"), plot.attribute("height")), (Some("560"), Some("290")));
    let line = with_class(&document, "f-line")[0];
    assert_eq!(line.attribute("d"), Some("M0 285l140-280M420 215l140-70"));
    // Fewer than forty samples: a dot on each.
    let dots = with_class(&document, "f-dots")[0].attribute("d").unwrap();
    assert_eq!(dots, "M0 285h.01M140 5h.01M420 215h.01M560 145h.01");
}

#[test]
fn the_image_says_what_it_shows_and_its_marks_too() {
    let mut figure = one(vec![1.0, 2.0], vec![Some(0.5), Some(0.6)]);
    let crosses = Series::values("bad", (Mark::Crosses, Ink::Second, Weight::Thin), vec![2.0], [Some(0.6)])
        .with_notes(vec!["MP01 · trial 2 · 0.6 · do not use".into()])
        .with_trust(vec![crate::trust::Level::DoNotUse]);
    figure.panels[0].series.push(crosses);
    figure.panels[0].spans.push(Span { from: 3.0, to: 4.0, label: "out of use".into() });
    figure.panels[0] = figure.panels[0].clone().with_rule(6.0, "session 2", RuleKind::Border);
    let (_, text) = drawn(&figure, &drawing(400, Theme::Light));
    let document = Document::parse(&text).unwrap();
    let root = document.root_element();
    assert_eq!(root.attribute("role"), Some("img"));
    let child = |name: &str| root.children().find(|child| child.has_tag_name(name)).and_then(|child| child.text());
    let named = |name: &str| root.children().position(|child| child.tag_name().name() == name);
    assert_eq!((named("title"), named("desc")), (Some(0), Some(1)));
    assert_eq!(child("title"), Some("One: all 2 samples"));
    assert_eq!(child("desc"), Some("One line. By a test."));
    let cross = with_class(&document, "f-cross")[0];
    assert_eq!(cross.attribute("data-trust"), Some("do_not_use"));
    assert_eq!(cross.first_element_child().unwrap().text(), Some("MP01 · trial 2 · 0.6 · do not use"));
    let hatch = with_class(&document, "f-hatch")[0];
    assert_eq!(hatch.first_element_child().unwrap().text(), Some("out of use"));
    assert!(text.contains(">session 2</text>"));
}

/// Whatever names are made of, they stay text; nothing of them becomes an element, an attribute or a style.
#[test]
fn names_are_never_markup() {
    let evil = "<script>alert(1)</script>\" onload=\"x' ]]> & &amp; \u{7}";
    let mut figure = one(vec![1.0, 2.0], vec![Some(0.5), Some(0.6)]);
    for text in [&mut figure.name, &mut figure.title, &mut figure.description, &mut figure.caption] {
        *text = evil.to_owned();
    }
    figure.x.label = evil.to_owned();
    figure.x.unit = evil.to_owned();
    let panel = &mut figure.panels[0];
    (panel.title, panel.y.label) = (evil.to_owned(), evil.to_owned());
    panel.spans.push(Span { from: 1.0, to: 2.0, label: evil.to_owned() });
    *panel = panel.clone().with_rule(0.5, evil, RuleKind::Reference);
    for (at, mark) in [Mark::Line, Mark::Points, Mark::Crosses].into_iter().enumerate() {
        let own = Series::values(evil, (mark, Ink::of_group(at), Weight::Thick), vec![1.0], [Some(0.5)]).labelled();
        panel.series.push(own.with_notes(vec![evil.to_owned()]));
    }
    panel.series.push(Series::intervals(
        evil,
        (Mark::Band, Ink::First, Weight::Thin),
        vec![1.0, 2.0],
        [Some([0.1, 0.2]), Some([0.1, 0.2])],
    ));
    for theme in Theme::ALL {
        for width in [280, 400, 1160] {
            let (_, text) = drawn(&figure, &drawing(width, theme));
            let document = Document::parse(&text).unwrap_or_else(|error| panic!("{error}: {text}"));
            let known = ["svg", "title", "desc", "style", "rect", "text", "path"];
            for node in document.descendants().filter(Node::is_element) {
                assert!(known.contains(&node.tag_name().name()), "{:?}", node.tag_name());
                assert!(!node.attributes().any(|one| one.name().starts_with("on")), "{node:?}");
            }
            let title = document.descendants().find(|node| node.has_tag_name("title")).unwrap();
            assert!(title.text().unwrap().starts_with("<script>alert(1)</script>\""), "{title:?}");
        }
    }
}

/// A page's figure needs no exception from a strict policy of contents.
#[test]
fn the_figure_of_a_page_has_no_style_of_its_own() {
    let figure = signals(&trial(812, 0.1), &origin());
    let (_, text) = drawn(&figure, &drawing(1160, Theme::Page));
    for forbidden in ["style", "script", "href", "id=", "url(", "#"] {
        assert!(!text.contains(forbidden), "{forbidden} in the figure of a page");
    }
    for theme in [Theme::Light, Theme::Dark, Theme::Paper] {
        assert_eq!(drawn(&figure, &drawing(1160, theme)).1.matches("<style>").count(), 1);
    }
    let paper = drawn(&figure, &drawing(680, Theme::Paper)).1;
    assert!(paper.contains("width=\"179.92mm\""), "{:.300}", paper);
}

/// The places that a series is drawn at are those of its numbers, to the rounding of the path.
#[test]
fn what_is_drawn_is_what_is_listed() {
    for (samples, noise) in [(812, 0.1), (2_001, 0.02), (40_001, 0.3)] {
        let figure = signals(&trial(samples, noise), &origin());
        let (seen, text) = drawn(&figure, &drawing(1160, Theme::Light));
        let document = Document::parse(&text).unwrap();
        let lines = with_class(&document, "f-line");
        let layout = Layout::new(&seen, 1160.0, Theme::Light);
        let series = seen
            .panels
            .iter()
            .zip(&layout.frames)
            .flat_map(|(panel, frame)| panel.series.iter().map(move |series| (panel, frame, series)));
        let mut checked = 0;
        for ((panel, frame, series), line) in series.zip(&lines) {
            assert_eq!(line.attribute("data-series"), Some(series.name.as_str()));
            let places: Vec<[f64; 2]> = read(line.attribute("d").unwrap()).into_iter().flatten().collect();
            let listed: Vec<[f64; 2]> = series
                .x
                .iter()
                .zip(&series.y)
                .map(|(x, y)| {
                    let height = (1.0 - panel.y.position(y.unwrap())) * frame.height + OVERLAP;
                    [seen.x.position(*x) * frame.width, height]
                })
                .collect();
            checked += listed.len();
            if series.x.len() as f64 <= frame.width {
                // Every sample at its place; neighbours at one place are drawn once.
                let mut rounded: Vec<[i64; 2]> = listed.iter().map(|place| place.map(tenths)).collect();
                rounded.dedup();
                let drawn: Vec<[i64; 2]> = places.iter().map(|place| place.map(tenths)).collect();
                assert_eq!(drawn, rounded, "{samples}, {}", series.name);
                continue;
            }
            // In every pixel column the same first, least, greatest and last, to half a pixel.
            let columns = |all: &[[f64; 2]], column_of: fn(f64) -> i64| {
                let mut found: Vec<(i64, [f64; 4])> = Vec::new();
                for [x, y] in all {
                    let own = column_of(*x);
                    match found.last_mut() {
                        Some((column, [_, least, most, last])) if *column == own => {
                            (*least, *most, *last) = (least.min(*y), most.max(*y), *y);
                        }
                        _ => found.push((own, [*y; 4])),
                    }
                }
                found
            };
            let (drawn, expected) =
                (columns(&places, |x| tenths(x).div_euclid(10)), columns(&listed, |x| x.floor() as i64));
            assert_eq!(drawn.len(), expected.len(), "{samples}, {}", series.name);
            for (drawn, expected) in drawn.iter().zip(&expected) {
                let is_close = drawn.1.iter().zip(&expected.1).all(|(a, b)| (a - b).abs() <= 0.5 + 1e-6);
                assert!(drawn.0 == expected.0 && is_close, "{samples}, {}: {drawn:?} {expected:?}", series.name);
            }
        }
        assert!(checked >= 4 * 812, "{samples}: {checked}");
        if samples == 40_001 {
            let most = KEPT * layout.columns() + 2;
            assert!(seen.panels.iter().flat_map(|p| &p.series).all(|s| s.x.len() <= most));
            assert!(seen.sampling.starts_with("one line per pixel"), "{}", seen.sampling);
        }
    }
}

/// Signals of 40,001 samples stay small at any width, whatever they are: smooth, noisy, or nothing but noise.
#[test]
fn signals_stay_small() {
    for noise in [0.0, 0.01, 0.03, 0.1, 0.5, 20.0] {
        let figure = signals(&trial(40_001, noise), &origin());
        for theme in [Theme::Page, Theme::Light] {
            let text = drawn(&figure, &drawing(1150, theme)).1;
            assert!(text.len() <= 80_000, "{} bytes with noise {noise}", text.len());
            assert!(text.matches('<').count() < 200, "{} elements", text.matches('<').count());
        }
        for zoom in [[0.0, 30.0], [10.0, 16.5], [10.0, 12.0], [30.0, 30.05]] {
            let view = Drawing { from: Some(zoom[0]), to: Some(zoom[1]), ..drawing(1150, Theme::Page) };
            let text = drawn(&figure, &view).1;
            assert!(text.len() <= 80_000, "{} bytes with noise {noise} in {zoom:?}", text.len());
        }
    }
}

#[test]
fn no_label_lies_outside_and_many_names_stand_in_a_legend() {
    let x: Vec<f64> = vec![0.0, 10.0];
    for names in [2, 4, 5, 9] {
        let mut figure = one(x.clone(), vec![Some(0.0), Some(1.0)]);
        figure.panels[0].series = (0..names)
            .map(|at| {
                let look = (Mark::Line, Ink::of_group(at % 4), Weight::Thick);
                Series::values(format!("group {at}"), look, x.clone(), [Some(0.5), Some(0.5)]).labelled()
            })
            .collect();
        for width in [280, 400, 1160] {
            let (_, text) = drawn(&figure, &drawing(width, Theme::Light));
            let document = Document::parse(&text).unwrap();
            let labels = with_class(&document, "f-name");
            assert_eq!(labels.len(), if names > 4 { 0 } else { names }, "{names} names at {width}");
            let mut heights: Vec<f64> =
                labels.iter().map(|label| label.attribute("y").unwrap().parse().unwrap()).collect();
            heights.sort_by(f64::total_cmp);
            assert!(heights.windows(2).all(|pair| pair[1] - pair[0] >= 14.9), "{heights:?}");
            let end: f64 = document.root_element().attribute("height").unwrap().parse().unwrap();
            for node in document.descendants().filter(|node| node.has_tag_name("text")) {
                let at = |key: &str| node.attribute(key).unwrap().parse::<f64>().unwrap();
                assert!((0.0..=f64::from(width)).contains(&at("x")) && (0.0..=end).contains(&at("y")), "{node:?}");
            }
            assert_eq!(text.matches(">group 8</text>").count(), usize::from(names == 9));
        }
    }
}
