//! The calibration problem: a model, residuals, a prior, bounds and constraints, as argmin sees it.
//!
//! $$ \min_\theta \sum_i \rho_i(r_i(\theta)) + \tfrac12 \Big\lVert \frac{\theta - \mu}{s} \Big\rVert^2
//! + \tfrac12 \sum_{a \sim b} \Big( \frac{\theta_a - \theta_b}{s_{ab}} \Big)^2,\quad l \le \theta \le u,\; c(\theta) \le 0 $$

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use argmin::core::{CostFunction, Error, Jacobian, Operator};
use nalgebra::{DMatrix, DVector};

use super::constraints::InequalityConstraint;
use super::journal::{Computed, Journal, JournalEntry};
use super::{Cluster, Loss, ParameterSpace, PersonalisationError, PriorResidual, Residual, TangentModel};

/// What is minimised, over which box, under which constraints.
pub struct CalibrationProblem<'a, M: TangentModel> {
    model: &'a M,
    residual: &'a dyn Residual<M::Trajectory>,
    losses: Vec<Loss>,
    prior: PriorResidual,
    lower: DVector<f64>,
    upper: DVector<f64>,
    constraints: Vec<Arc<dyn InequalityConstraint + 'a>>,
    stop: Option<&'a AtomicBool>,
    journal: Arc<Journal<'a>>,
}

/// The objective at one point.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// Data rows, over their standard deviations.
    pub rows: DVector<f64>,
    /// Σ ρ(r).
    pub data_cost: f64,
    /// ½ ‖(θ − μ)/s‖².
    pub prior_cost: f64,
    /// Σ max(0, c).
    pub violation: f64,
}

impl Evaluation {
    /// The objective.
    pub fn cost(&self) -> f64 {
        self.data_cost + self.prior_cost
    }
}

/// The objective around one point: rows r, their Jacobian J (rows × p) and losses, and the prior.
#[derive(Debug, Clone, PartialEq)]
pub struct Linearisation {
    /// The point θ.
    pub coordinates: DVector<f64>,
    /// Data rows.
    pub rows: DVector<f64>,
    /// dr/dθ.
    pub jacobian: DMatrix<f64>,
    /// Loss of every row.
    pub losses: Vec<Loss>,
    /// The prior.
    pub prior: PriorResidual,
}

impl Linearisation {
    /// Weights of iteratively reweighted least squares for rows `rows`.
    pub fn weights(&self, rows: &DVector<f64>) -> DVector<f64> {
        DVector::from_iterator(rows.len(), rows.iter().zip(&self.losses).map(|(&row, loss)| loss.weight(row)))
    }

    /// H = JᵀWJ + S⁻² and g = JᵀWr + S⁻²(θ − μ). With the weights of `self.rows`, g is the exact gradient of the objective.
    pub fn quadratic_model(&self, weights: &DVector<f64>) -> (DMatrix<f64>, DVector<f64>) {
        let mut weighted = self.jacobian.clone();
        for (mut row, &weight) in weighted.row_iter_mut().zip(weights) {
            row *= weight;
        }
        let precision = self.prior.precision();
        let hessian = self.jacobian.tr_mul(&weighted) + &precision;
        // The two triangles of the product are rounded differently.
        let hessian = (&hessian + hessian.transpose()) * 0.5;
        let gradient = weighted.tr_mul(&self.rows) + precision * (&self.coordinates - self.prior.mean());
        (hessian, gradient)
    }

    /// Gradient of the objective.
    pub fn gradient(&self) -> DVector<f64> {
        self.quadratic_model(&self.weights(&self.rows)).1
    }

    /// Σ ρ(r + Jδ) + ½ ‖(θ + δ − μ)/s‖²: the objective with linearised residuals.
    pub fn model_cost(&self, step: &DVector<f64>) -> f64 {
        let rows = &self.rows + &self.jacobian * step;
        let data: f64 = rows.iter().zip(&self.losses).map(|(&row, loss)| loss.value(row)).sum();
        data + 0.5 * self.prior.evaluate(&(&self.coordinates + step)).norm_squared()
    }

    /// Whether any loss is not quadratic.
    pub fn is_robust(&self) -> bool {
        self.losses.iter().any(|loss| *loss != Loss::Squares)
    }
}

impl<'a, M: TangentModel> CalibrationProblem<'a, M> {
    /// A problem in the coordinates of `space`, with its bounds and prior.
    ///
    /// # Errors
    /// [`PersonalisationError`] for a prior that is none.
    pub fn new(model: &'a M, residual: &'a dyn Residual<M::Trajectory>, space: &ParameterSpace) -> Result<Self, PersonalisationError> {
        let prior = PriorResidual::new(space.prior_mean(), space.prior_sd())?.with_ties(space.ties().to_vec())?;
        Self::in_box(model, residual, prior, space.lower(), space.upper())
    }

    /// A problem in coordinates of any meaning: `prior`, `lower` and `upper` have one entry a coordinate.
    ///
    /// # Errors
    /// [`PersonalisationError`] if sizes differ or bounds cross.
    pub fn in_box(
        model: &'a M,
        residual: &'a dyn Residual<M::Trajectory>,
        prior: PriorResidual,
        lower: DVector<f64>,
        upper: DVector<f64>,
    ) -> Result<Self, PersonalisationError> {
        let expected = prior.mean().len();
        for (what, found) in [("lower bounds", lower.len()), ("upper bounds", upper.len())] {
            if found != expected {
                return Err(PersonalisationError::Shape { what, found, expected });
            }
        }
        if let Some(index) = (0..expected).find(|&index| lower[index].is_nan() || upper[index].is_nan() || lower[index] > upper[index]) {
            let remedy = "must not lie above its upper bound";
            return Err(PersonalisationError::Setting { what: "lower bound", value: lower[index], remedy });
        }
        let mut losses = vec![Loss::Squares; residual.row_count()];
        residual.write_losses(&mut losses);
        let (constraints, journal) = (Vec::new(), Arc::default());
        Ok(Self { model, residual, losses, prior, lower, upper, constraints, stop: None, journal })
    }

    /// Adds a constraint.
    #[must_use]
    pub fn with_constraint(mut self, constraint: impl InequalityConstraint + 'a) -> Self {
        self.constraints.push(Arc::new(constraint));
        self
    }

    /// Stops before the next evaluation once `flag` is set.
    #[must_use]
    pub fn with_stop_flag(mut self, flag: &'a AtomicBool) -> Self {
        self.stop = Some(flag);
        self
    }

    /// Takes what an earlier search of the same problem computed, and keeps what this one computes, in `journal`.
    #[must_use]
    pub fn with_journal(mut self, journal: Journal<'a>) -> Self {
        self.journal = Arc::new(journal);
        self
    }

    /// The same problem, its journal and what it has spent, with the prior of another space and without constraints.
    ///
    /// # Errors
    /// As [`CalibrationProblem::new`].
    pub fn with_prior_of(self, space: &ParameterSpace) -> Result<Self, PersonalisationError> {
        let prior = PriorResidual::new(space.prior_mean(), space.prior_sd())?.with_ties(space.ties().to_vec())?;
        Ok(Self { prior, constraints: Vec::new(), ..self })
    }

    /// Simulations spent so far.
    pub fn spent(&self) -> f64 {
        self.journal.spent()
    }

    /// The same problem with one coordinate held at a value (moved into its box).
    #[must_use]
    pub fn with_fixed(&self, index: usize, coordinate: f64) -> Self {
        let mut held = Self {
            model: self.model,
            residual: self.residual,
            losses: self.losses.clone(),
            prior: self.prior.clone(),
            lower: self.lower.clone(),
            upper: self.upper.clone(),
            constraints: self.constraints.clone(),
            stop: self.stop,
            journal: Arc::clone(&self.journal),
        };
        let value = coordinate.max(self.lower[index]).min(self.upper[index]);
        (held.lower[index], held.upper[index]) = (value, value);
        held
    }

    /// Number of coordinates.
    pub fn dimension(&self) -> usize {
        self.lower.len()
    }

    /// Lower bounds.
    pub fn lower(&self) -> &DVector<f64> {
        &self.lower
    }

    /// Upper bounds.
    pub fn upper(&self) -> &DVector<f64> {
        &self.upper
    }

    /// Natural size of a step a coordinate: the prior's standard deviation, else a quarter of the box, else one.
    pub fn scales(&self) -> DVector<f64> {
        DVector::from_fn(self.dimension(), |index, _| {
            let candidates = [self.prior.sd()[index], (self.upper[index] - self.lower[index]) / 4.0];
            candidates.into_iter().find(|scale| scale.is_finite() && *scale > 0.0).unwrap_or(1.0)
        })
    }

    /// The prior.
    pub fn prior(&self) -> &PriorResidual {
        &self.prior
    }

    /// The constraints.
    pub fn constraints(&self) -> impl ExactSizeIterator<Item = &dyn InequalityConstraint> + '_ {
        self.constraints.iter().map(|constraint| constraint.as_ref() as &dyn InequalityConstraint)
    }

    /// The clusters of all data rows.
    pub fn clusters(&self) -> Vec<Cluster> {
        let mut clusters = vec![Cluster::default(); self.residual.row_count()];
        self.residual.write_clusters(&mut clusters);
        clusters
    }

    /// Whether someone asked to stop.
    pub fn is_stopped(&self) -> bool {
        self.stop.is_some_and(|flag| flag.load(Ordering::SeqCst))
    }

    /// The nearest point of the box.
    pub fn clamp(&self, coordinates: &DVector<f64>) -> DVector<f64> {
        coordinates.sup(&self.lower).inf(&self.upper)
    }

    /// Simulates and compares.
    ///
    /// # Errors
    /// [`PersonalisationError::Stopped`], [`PersonalisationError::Simulation`] or [`PersonalisationError::NonFiniteResidual`].
    pub fn evaluate(&self, coordinates: &DVector<f64>) -> Result<Evaluation, PersonalisationError> {
        self.check_stop()?;
        let known = self.journal.rows(coordinates).map_or_else(|| self.simulate(coordinates), Ok)?;
        let rows = known.map_err(|words| self.failure(coordinates, FailedBefore(words)))?;
        if let Some((row, &value)) = rows.iter().enumerate().find(|(_, value)| !value.is_finite()) {
            let coordinates = coordinates.iter().copied().collect();
            return Err(PersonalisationError::NonFiniteResidual { row, value, coordinates });
        }
        let data_cost = rows.iter().zip(&self.losses).map(|(&row, loss)| loss.value(row)).sum();
        let prior_cost = 0.5 * self.prior.evaluate(coordinates).norm_squared();
        let violation = self.constraints.iter().map(|constraint| constraint.value(coordinates).max(0.0)).sum();
        Ok(Evaluation { rows, data_cost, prior_cost, violation })
    }

    /// The rows of a simulation, or its failure; in the journal from now on.
    fn simulate(&self, coordinates: &DVector<f64>) -> Result<Result<DVector<f64>, String>, PersonalisationError> {
        let computed = match self.model.simulate(coordinates) {
            Ok(trajectory) => {
                let mut rows = DVector::zeros(self.residual.row_count());
                self.residual.evaluate(&trajectory, rows.as_mut_slice());
                Computed::Rows(rows)
            }
            Err(_) if self.is_stopped() => return Err(PersonalisationError::Stopped),
            Err(error) => Computed::Failure(crate::personalisation::error::chain(&error)),
        };
        self.journal.write(&JournalEntry { coordinates: coordinates.clone(), computed });
        // Charged where it is read.
        Ok(self.journal.rows(coordinates).unwrap_or_else(|| Err("lost from the journal".to_owned())))
    }

    /// The linearised residuals at a point already evaluated.
    ///
    /// # Errors
    /// As [`Self::evaluate`].
    pub fn linearise(&self, coordinates: &DVector<f64>, evaluation: &Evaluation) -> Result<Linearisation, PersonalisationError> {
        self.check_stop()?;
        let rows = evaluation.rows.clone();
        let cost = self.model.tangent_cost(self.dimension());
        let known = self.journal.jacobian(coordinates, cost).filter(|jacobian| jacobian.shape() == (rows.len(), self.dimension()));
        let jacobian = known.map_or_else(|| self.differentiate(coordinates, cost), Ok)?;
        if let Some(entry) = jacobian.iter().position(|entry| !entry.is_finite()) {
            let (row, coordinates) = (entry % rows.len().max(1), coordinates.iter().copied().collect());
            return Err(PersonalisationError::NonFiniteResidual { row, value: f64::NAN, coordinates });
        }
        let (losses, prior) = (self.losses.clone(), self.prior.clone());
        Ok(Linearisation { coordinates: coordinates.clone(), rows, jacobian, losses, prior })
    }

    /// The Jacobian of the rows; in the journal from now on.
    fn differentiate(&self, coordinates: &DVector<f64>, cost: f64) -> Result<DMatrix<f64>, PersonalisationError> {
        let (trajectory, tangents) = self.model.simulate_with_tangents(coordinates).map_err(|error| self.failure(coordinates, error))?;
        if tangents.len() != self.dimension() {
            let (found, expected) = (tangents.len(), self.dimension());
            return Err(PersonalisationError::Shape { what: "tangents", found, expected });
        }
        let row_count = self.residual.row_count();
        let mut jacobian = DMatrix::zeros(row_count, self.dimension());
        let mut column = vec![0.0; row_count];
        for (index, tangent) in tangents.iter().enumerate() {
            self.residual.apply_tangent(&trajectory, tangent, &mut column);
            jacobian.column_mut(index).copy_from_slice(&column);
        }
        let entry = JournalEntry { coordinates: coordinates.clone(), computed: Computed::Jacobian(jacobian.clone()) };
        self.journal.write(&entry);
        let _charged = self.journal.jacobian(coordinates, cost);
        Ok(jacobian)
    }

    fn check_stop(&self) -> Result<(), PersonalisationError> {
        if self.is_stopped() { Err(PersonalisationError::Stopped) } else { Ok(()) }
    }

    /// A simulation that fails after a request to stop was stopped.
    fn failure(&self, coordinates: &DVector<f64>, error: impl std::error::Error + Send + Sync + 'static) -> PersonalisationError {
        if self.is_stopped() {
            return PersonalisationError::Stopped;
        }
        PersonalisationError::Simulation { coordinates: coordinates.iter().copied().collect(), source: Box::new(error) }
    }
}

/// The words of a simulation that failed, now or in an earlier search.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct FailedBefore(String);

impl<M: TangentModel> CostFunction for CalibrationProblem<'_, M> {
    type Param = DVector<f64>;
    type Output = f64;

    fn cost(&self, coordinates: &Self::Param) -> Result<f64, Error> {
        Ok(self.evaluate(coordinates)?.cost())
    }
}

impl<M: TangentModel> Operator for CalibrationProblem<'_, M> {
    type Param = DVector<f64>;
    type Output = DVector<f64>;

    fn apply(&self, coordinates: &Self::Param) -> Result<DVector<f64>, Error> {
        Ok(self.evaluate(coordinates)?.rows)
    }
}

impl<M: TangentModel> Jacobian for CalibrationProblem<'_, M> {
    type Param = DVector<f64>;
    type Jacobian = DMatrix<f64>;

    fn jacobian(&self, coordinates: &Self::Param) -> Result<DMatrix<f64>, Error> {
        let evaluation = self.evaluate(coordinates)?;
        Ok(self.linearise(coordinates, &evaluation)?.jacobian)
    }
}
