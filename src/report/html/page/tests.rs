//! Claims of the page as a whole: nothing from outside becomes markup, nothing is fetched, nothing empty is shown.

use nalgebra::Vector3;

use super::*;
use crate::report::figures::{Curve, Look, Montage, MontagePanel, SurfaceView};
use crate::report::html::{SurfaceField, SurfaceValues};

const HOSTILE: &str = "</script><img src=x onerror=alert(1)>\"'{{data}}";

fn montage() -> Montage {
    let panel =
        MontagePanel { columns: 8, rows: 8, intensity: vec![10.0; 64], origin_mm: [0.0; 2], spacing_mm: [1.0; 2], contours: vec![] };
    Montage {
        title: HOSTILE.into(),
        surfaces: vec![HOSTILE.into()],
        column_titles: vec![HOSTILE.into(); 2],
        row_titles: vec![HOSTILE.into()],
        panels: vec![panel; 2],
        window: (0.0, 255.0),
    }
}

fn heart() -> BeatingHeart {
    let corners = vec![Vector3::zeros(), Vector3::x(), Vector3::y()];
    let view = SurfaceView { name: HOSTILE.into(), to_eye: Vector3::z(), up: Vector3::y() };
    let field = SurfaceField {
        name: HOSTILE.into(),
        unit: HOSTILE.into(),
        values: SurfaceValues::Constant(vec![0.0, 1.0, 2.0]),
        scale: Scale::Sequential,
    };
    BeatingHeart {
        frames_mm: vec![corners.clone(), corners],
        parts: vec![(HOSTILE.into(), vec![[0, 1, 2]])],
        fields: vec![field],
        views: vec![view],
    }
}

fn hostile_page() -> Page {
    let text = || HOSTILE.to_owned();
    let figure = KeyFigure { name: text(), value: text(), unit: text(), beside: Some(text()) };
    let table = Table { caption: text(), columns: vec![text()], rows: vec![vec![text()]] };
    let plot = Plot::over_time(text(), text(), &[Curve::new(text(), Look::Simulated, &[0.0, 1.0], &[0.0, 1.0])]);
    let blocks = vec![
        Block::Text(text()),
        Block::List(vec![text()]),
        Block::Warnings(vec![text()]),
        Block::KeyFigures(vec![figure]),
        Block::Table(table),
        Block::Plot(plot),
        Block::Slices(Slices(montage())),
        Block::Heart(heart()),
        Block::Folded(text(), vec![Block::Text(text())]),
    ];
    Page {
        title: text(),
        question: text(),
        status: (text(), false),
        sections: vec![Section { title: text(), blocks }, Section { title: "nothing to see".into(), blocks: vec![] }],
        frame_times_s: vec![0.0, 0.1],
        provenance: vec![(text(), text())],
    }
}

#[test]
fn text_from_outside_never_becomes_markup() {
    let html = html(&hostile_page()).unwrap();
    assert!(!html.contains("<img src=x"), "an element came in");
    // In the data quotation marks are JSON's; there nothing but `<` can do harm.
    let shown = html.split("<script type=\"application/json\"").next().unwrap();
    assert!(shown.contains("&#39;{{data}}") && !shown.contains("'{{data}}"), "a quotation mark came in");
    // Style, data, library and script: each opened and closed once.
    assert_eq!(html.matches("<script").count(), html.matches("</script>").count());
    assert_eq!(html.matches("</script>").count(), 3);
    let data = html.split("id=\"report-data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let read: serde_json::Value = serde_json::from_str(data).unwrap();
    assert_eq!(read["heart"]["parts"][0]["name"], HOSTILE);
    assert_eq!(read["slices"]["views"][0]["title"], HOSTILE);
}

#[test]
fn what_is_empty_is_left_out_and_brings_no_library() {
    let page = Page { title: "a".into(), sections: vec![Section { title: "Gone".into(), blocks: vec![] }], ..Page::default() };
    let html = html(&page).unwrap();
    assert!(!html.contains("Gone") && !html.contains("id=\"controls\""));
    assert!(html.len() < 60_000, "a page without a mesh has {} bytes", html.len());
}

#[test]
fn embedded_scripts_cannot_end_their_element() {
    for (name, text) in [("the library", LIBRARY), ("the script", SCRIPT), ("the style", STYLE)] {
        for end in ["</script", "<!--", "</style"] {
            assert!(!text.to_lowercase().contains(end), "{name} holds {end}");
        }
    }
}

/// The page's own policy forbids whatever is not inside of it.
#[test]
fn nothing_is_fetched() {
    assert!(TEMPLATE.contains("default-src 'none'"));
    for text in [TEMPLATE, STYLE, SCRIPT] {
        for word in ["http://", "https://", "@import", "fetch(", "XMLHttpRequest"] {
            assert!(!text.replace("http://www.w3.org/2000/svg", "").contains(word), "{word}");
        }
    }
}

#[test]
fn names_are_filled_in_once() {
    let parts = [("a", "{{b}}".to_owned()), ("b", "two".to_owned())];
    assert_eq!(filled("<{{a}}|{{b}}|{{c}}>", &parts), "<{{b}}|two|>");
}
