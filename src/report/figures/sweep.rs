//! What becomes of several ways to do a thing over two settings: a grid a way, a cell a pair of settings, and where it breaks.

use std::path::Path;

use plotters::prelude::*;
use plotters::style::text_anchor::HPos;

use super::style::*;
use crate::report::ReportError;

/// What became of one pair of settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SweepCell {
    /// It came to an end, with this result.
    Result(f64),
    /// It broke after this long, ms.
    BrokeAfterMs(f64),
    /// It was not tried.
    Untried,
}

/// Grids side by side.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    /// Title.
    pub title: String,
    /// What the columns are.
    pub column_quantity: String,
    /// What the rows are.
    pub row_quantity: String,
    /// The setting of each column.
    pub columns: Vec<String>,
    /// The setting of each row, from above.
    pub rows: Vec<String>,
    /// Name and cells of each grid, row by row.
    pub grids: Vec<(String, Vec<SweepCell>)>,
}

const CELL: (u32, u32) = (84, 56);
const LEFT: u32 = 120;
const GAP: u32 = 36;
const HEAD: u32 = 130;
const FOOT: u32 = 140;
/// Width of a letter, generously.
const LETTER: u32 = 17;

/// Draws a sweep: the darker a cell, the greater its result; what broke is crossed.
///
/// # Errors
/// [`ReportError`] if the figure cannot be drawn or written.
pub fn sweep(file: &Path, figure: &Sweep) -> Result<(), ReportError> {
    let (columns, rows) = (figure.columns.len().max(1) as u32, figure.rows.len().max(1) as u32);
    let letters = figure.grids.iter().map(|(name, _)| name.chars().count() as u32).max().unwrap_or(0);
    let grid_width = (CELL.0 * columns).max(LETTER * letters);
    let width = (LETTER * figure.title.chars().count() as u32).max(LEFT + figure.grids.len().max(1) as u32 * (grid_width + GAP));
    let bottom = HEAD + CELL.1 * rows;
    let results = figure.grids.iter().flat_map(|(_, cells)| cells).filter_map(|cell| match cell {
        SweepCell::Result(value) => Some(*value),
        _ => None,
    });
    let (low, high) = padded(results, 0.0, 0.0);
    picture(file, "the sweep", (width, bottom + FOOT), |area| {
        write(area, &figure.title, &bold(TITLE, &BLACK_INK), HPos::Left, (ipx(28), ipx(36)))?;
        let middle = ipx((HEAD + bottom) / 2);
        write_upward(area, &figure.row_quantity, &text(TEXT - 2, &BLACK_INK), HPos::Center, (ipx(26), middle))?;
        for (row, words) in figure.rows.iter().enumerate() {
            let y = ipx(HEAD + CELL.1 * row as u32 + CELL.1 / 2);
            write(area, words, &text(TEXT - 4, &GREY_INK), HPos::Right, (ipx(LEFT - 14), y))?;
        }
        for (place, (name, cells)) in figure.grids.iter().enumerate() {
            let left = LEFT + place as u32 * (grid_width + GAP);
            write(area, name, &bold(TEXT - 2, &BLACK_INK), HPos::Left, (ipx(left), ipx(HEAD - 28)))?;
            for (column, words) in figure.columns.iter().enumerate() {
                let x = ipx(left + CELL.0 * column as u32 + CELL.0 / 2);
                write(area, words, &text(TEXT - 4, &GREY_INK), HPos::Center, (x, ipx(bottom + 22)))?;
            }
            write(
                area,
                &figure.column_quantity,
                &text(TEXT - 4, &GREY_INK),
                HPos::Center,
                (ipx(left + CELL.0 * columns / 2), ipx(bottom + 56)),
            )?;
            for (number, cell) in cells.iter().enumerate() {
                let (column, row) = (number as u32 % columns, number as u32 / columns);
                draw_cell(area, (ipx(left + CELL.0 * column), ipx(HEAD + CELL.1 * row)), *cell, (low, high))?;
            }
        }
        let words = "× n: broken n ms after the start";
        write(area, words, &text(TEXT - 4, &VERMILION), HPos::Left, (ipx(LEFT), ipx(bottom + 102)))
    })
}

fn draw_cell(area: &Area, (x, y): (i32, i32), cell: SweepCell, (low, high): (f64, f64)) -> Drawn {
    let centre = (x + ipx(CELL.0) / 2, y + ipx(CELL.1) / 2);
    let frame = [(x, y), (x + ipx(CELL.0) - ipx(2), y + ipx(CELL.1) - ipx(2))];
    match cell {
        SweepCell::Result(value) => {
            let share = if high > low { (value - low) / (high - low) } else { 0.0 };
            let ink = if share > 0.55 { WHITE } else { BLACK_INK };
            area.draw(&Rectangle::new(frame, blend(RGBColor(232, 242, 250), BLUE_INK, share).filled()))?;
            write(area, &format!("{value:.1}"), &text(TEXT - 4, &ink), HPos::Center, centre)
        }
        SweepCell::BrokeAfterMs(after_ms) => {
            area.draw(&Rectangle::new(frame, RGBColor(252, 228, 214).filled()))?;
            write(area, &format!("× {after_ms:.0}"), &text(TEXT - 4, &VERMILION), HPos::Center, centre)
        }
        SweepCell::Untried => Ok(area.draw(&Rectangle::new(frame, RULE.stroke_width(px(1))))?),
    }
}

fn blend(from: RGBColor, to: RGBColor, share: f64) -> RGBColor {
    let one = |a: u8, b: u8| (f64::from(a) + (f64::from(b) - f64::from(a)) * share.clamp(0.0, 1.0)).round() as u8;
    RGBColor(one(from.0, to.0), one(from.1, to.1), one(from.2, to.2))
}
