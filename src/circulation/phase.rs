//! The four phases of a ventricle, read off its valves, \[Billet2009\] §2.

use serde::{Deserialize, Serialize};

use super::OpenValves;

/// Where a ventricle stands in its cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// The inflow valve is open.
    Filling,
    /// Both valves are shut after filling.
    IsovolumetricContraction,
    /// The outflow valve is open.
    Ejection,
    /// Both valves are shut after ejection.
    IsovolumetricRelaxation,
}

impl Phase {
    /// All phases in the order of a beat, from the end of filling on.
    pub const CYCLE: [Self; 4] = [Self::IsovolumetricContraction, Self::Ejection, Self::IsovolumetricRelaxation, Self::Filling];

    /// The phase that follows when the valves stand as `open`: shut valves mean contraction after filling and relaxation after ejection.
    #[must_use]
    pub fn after(self, open: OpenValves) -> Self {
        match (open, self) {
            (OpenValves::Inflow, _) => Self::Filling,
            (OpenValves::Outflow | OpenValves::Both, _) => Self::Ejection,
            (OpenValves::Neither, Self::Filling | Self::IsovolumetricContraction) => Self::IsovolumetricContraction,
            (OpenValves::Neither, Self::Ejection | Self::IsovolumetricRelaxation) => Self::IsovolumetricRelaxation,
        }
    }

    /// Name as written in `curves.csv`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Filling => "filling",
            Self::IsovolumetricContraction => "isovolumetric_contraction",
            Self::Ejection => "ejection",
            Self::IsovolumetricRelaxation => "isovolumetric_relaxation",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beat_of_valve_states_gives_the_four_phases_in_order() {
        use OpenValves::{Inflow, Neither, Outflow};
        let mut phase = Phase::Filling;
        let mut seen = vec![];
        for open in [Inflow, Neither, Neither, Outflow, Outflow, Neither, Inflow] {
            phase = phase.after(open);
            if seen.last() != Some(&phase) {
                seen.push(phase);
            }
        }
        assert_eq!(seen[0], Phase::Filling);
        assert_eq!(seen[1..], Phase::CYCLE);
    }
}
