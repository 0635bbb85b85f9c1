//! The correlations of what was found, as a matrix of colours with their numbers.

use std::fmt::Write;

use super::bars::shortened;
use super::colour::{Scale, hex, ink_on};
use super::escape::escaped;
use super::number::place;
use super::plot::{figure, open};

/// Correlations of some parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct CorrelationMatrix {
    /// What they are.
    pub title: String,
    /// The parameters.
    pub names: Vec<String>,
    /// Correlations, row by row.
    pub values: Vec<Vec<f64>>,
}

impl CorrelationMatrix {
    /// Draws the matrix.
    pub(super) fn html(&self) -> String {
        let count = self.names.len().max(1) as f64;
        let letters = self.names.iter().map(|name| name.chars().count()).max().unwrap_or(0).min(40) as f64;
        let left = 20.0 + 6.6 * letters;
        let cell = ((640.0 - left - 8.0) / count).min(56.0);
        let height = 24.0 + cell * count + 6.0;
        let strongest = self.pairs().max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()));
        let spoken = strongest.map_or(String::new(), |(a, b, value)| format!("Strongest: {a} with {b}, {value:.2}"));
        let mut svg = open(&self.title, &spoken, 640.0, height);
        for (n, name) in self.names.iter().enumerate() {
            let middle = (n as f64 + 0.5) * cell;
            let label = escaped(&format!("{}  {}", shortened(name, 40), n + 1));
            let _ =
                write!(svg, "<text class=\"tick left\" x=\"{}\" y=\"{}\">{label}</text>", place(left - 8.0), place(24.0 + middle + 4.0));
            let _ = write!(svg, "<text class=\"tick\" x=\"{}\" y=\"16\">{}</text>", place(left + middle), n + 1);
        }
        for (n, row) in self.values.iter().enumerate() {
            for (m, &value) in row.iter().enumerate() {
                let (x, y) = (left + m as f64 * cell, 24.0 + n as f64 * cell);
                let colour = Scale::Diverging.colour(if value.is_finite() { value } else { 0.0 }, (-1.0, 1.0));
                let size = place(cell - 1.0);
                let _ = write!(
                    svg,
                    "<rect x=\"{}\" y=\"{}\" width=\"{size}\" height=\"{size}\" fill=\"{}\"/>",
                    place(x),
                    place(y),
                    hex(colour)
                );
                if cell > 30.0 {
                    let text = format!("{value:.2}").replace('-', "−");
                    let (x, y) = (place(x + 0.5 * cell), place(y + 0.5 * cell + 4.0));
                    let _ = write!(svg, "<text class=\"cell\" x=\"{x}\" y=\"{y}\" fill=\"{}\">{text}</text>", ink_on(colour));
                }
            }
        }
        svg.push_str("</svg>");
        figure(&self.title, &svg)
    }

    fn pairs(&self) -> impl Iterator<Item = (&str, &str, f64)> {
        let of =
            |(n, row): (usize, &Vec<f64>)| row.iter().take(n).copied().enumerate().map(move |(m, value)| (n, m, value)).collect::<Vec<_>>();
        self.values.iter().enumerate().flat_map(of).map(|(n, m, value)| (self.names[n].as_str(), self.names[m].as_str(), value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_strongest_pair_is_told() {
        let names = ["a", "b", "c"].map(str::to_owned).to_vec();
        let values = vec![vec![1.0, 0.2, -0.9], vec![0.2, 1.0, 0.1], vec![-0.9, 0.1, 1.0]];
        let html = CorrelationMatrix { title: "Correlations".into(), names, values }.html();
        assert!(html.contains("Strongest: c with a, -0.90") && html.contains(">−0.90<"));
    }
}
