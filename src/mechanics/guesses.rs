//! The last responses, from which the next ones start.

use nalgebra::Vector3;

use super::solver::Product;

/// Memory of the responses and of their products with the system's matrix.
#[derive(Debug, Default)]
pub(super) struct Guesses {
    responses: Vec<Vec<Vector3<f64>>>,
    weights: Vec<f64>,
    products: Vec<Vec<Vector3<f64>>>,
    usable: Vec<usize>,
}

impl Guesses {
    /// Subtracts A times the last response, scaled so that the least is left.
    pub(super) fn subtract(&mut self, product: &Product<'_>, columns: &mut [Vec<Vector3<f64>>]) {
        let Self { responses, weights, products, usable } = self;
        weights.clear();
        weights.resize(columns.len(), 0.0);
        responses.resize_with(responses.len().max(columns.len()), Vec::new);
        products.resize_with(responses.len(), Vec::new);
        usable.clear();
        usable.extend((0..columns.len()).filter(|&place| responses[place].len() == columns[place].len()));
        usable.iter().for_each(|&place| products[place].resize(columns[place].len(), Vector3::zeros()));
        product(usable, responses, products);
        for &place in &*usable {
            let (column, product) = (&mut columns[place], &products[place]);
            let (overlap, square) =
                product.iter().zip(column.iter()).fold((0.0, 0.0), |(o, s), (a, g)| (o + a.dot(g), s + a.norm_squared()));
            let weight = if square > 0.0 && (overlap / square).is_finite() { overlap / square } else { 0.0 };
            column.iter_mut().zip(product).for_each(|(column, product)| *column -= product * weight);
            weights[place] = weight;
        }
    }

    /// Adds to the corrections what was subtracted, and keeps the sums.
    pub(super) fn add_and_keep(&mut self, columns: &mut [Vec<Vector3<f64>>]) {
        for ((column, guess), weight) in columns.iter_mut().zip(&mut self.responses).zip(&self.weights) {
            if guess.len() == column.len() {
                column.iter_mut().zip(guess.iter()).for_each(|(column, guess)| *column += guess * *weight);
            }
            guess.clear();
            guess.extend_from_slice(column);
        }
    }
}
