//! Every parameter of the model in one table: name with unit, section of the study file, default, physical range, source.
//!
//! The name is the same string in the study file, in `parameters.csv` and on the command line.

use std::collections::BTreeMap;
use std::ops::Index;

use super::{Part, RegionalParameter};

/// Which table of the study file a parameter is written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Section {
    /// `[electrophysiology]`
    Electrophysiology,
    /// `[mechanics]`
    Mechanics,
    /// `[circulation]`
    Circulation,
    /// `[tracking]`
    Tracking,
}

impl Section {
    /// The key of the table in a study file.
    pub fn key(self) -> &'static str {
        match self {
            Self::Electrophysiology => "electrophysiology",
            Self::Mechanics => "mechanics",
            Self::Circulation => "circulation",
            Self::Tracking => "tracking",
        }
    }
}

/// What is known of a parameter before any patient is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterSpec {
    /// Name, with its unit last.
    pub name: &'static str,
    /// Symbol in the equations.
    pub symbol: &'static str,
    /// Unit, for people.
    pub unit: &'static str,
    /// Where it is written in a study file.
    pub section: Section,
    /// Value used where a study says nothing.
    pub default: f64,
    /// Smallest physical value (inclusive).
    pub lower: f64,
    /// Largest physical value (inclusive).
    pub upper: f64,
    /// What it is.
    pub meaning: &'static str,
    /// Where the default comes from.
    pub source: &'static str,
}

macro_rules! parameter_table {
    ($($variant:ident: $section:ident $name:literal $symbol:literal [$unit:literal] = $default:literal in $lower:literal..$upper:literal, $meaning:literal, $source:literal;)*) => {
        /// A parameter of the model.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Parameter { $(#[doc = $meaning] $variant,)* }

        impl Parameter {
            /// All parameters, in the order of the table.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// What is known of this parameter.
            pub fn spec(self) -> &'static ParameterSpec {
                const SPECS: &[ParameterSpec] = &[$(ParameterSpec {
                    name: $name, symbol: $symbol, unit: $unit, section: Section::$section, default: $default,
                    lower: $lower, upper: $upper, meaning: $meaning, source: $source,
                }),*];
                &SPECS[self as usize]
            }
        }
    };
}

parameter_table! {
    ConductionVelocity: Electrophysiology "conduction_velocity_mm_per_s" "v" ["mm/s"] = 600.0 in 50.0..3000.0, "Conduction velocity v along the fibre.", "[Sermesant2012]: 0.3-0.7 m/s in human myocardium; the left ventricle is activated within 65 ms";
    AnisotropyRatio: Electrophysiology "anisotropy_ratio" "ρ" ["1"] = 0.16 in 0.01..1.0, "Ratio ρ of squared speeds across and along the fibre, D = diag(1, ρ, ρ).", "measured ratio of speeds 2.5-3";
    EndocardialSpeedFactor: Electrophysiology "endocardial_speed_factor" "v_endo/v" ["1"] = 4.0 in 1.0..10.0, "Speed of the thin endocardial (Purkinje) layer relative to the bulk.", "Purkinje 2-4 m/s";
    OnsetTime: Electrophysiology "onset_time_s" "t_on" ["s"] = 0.02 in -0.5..1.0, "First depolarisation after the trigger (R wave).", "chosen: trigger on the R wave";
    ActionPotentialDuration: Electrophysiology "action_potential_duration_s" "APD" ["s"] = 0.3 in 0.05..0.6, "Action potential duration APD.", "0.25-0.33 s";
    HeartPeriod: Electrophysiology "heart_period_s" "HP" ["s"] = 0.8 in 0.25..2.5, "Heart period HP; a cine sequence sets it.", "75 beats a minute";
    ContractionPeakLv: Mechanics "contraction_peak_lv_kpa" "σ0_LV" ["kPa"] = 120.0 in 0.0..1000.0, "Peak contraction σ0 of the left ventricle.", "chosen with the stiffness: EF 0.57, 114/68 mmHg on the idealised left ventricle; [Billet2009] §6.2 has 90";
    ContractionPeakRv: Mechanics "contraction_peak_rv_kpa" "σ0_RV" ["kPa"] = 125.0 in 0.0..1000.0, "Peak contraction σ0 of the right ventricle.", "chosen: ejects as much as the left of the idealised biventricle, EF 0.51; [Billet2009] §6.2 has 70";
    ContractionPeakScar: Mechanics "contraction_peak_scar_kpa" "σ0_scar" ["kPa"] = 80.0 in 0.0..1000.0, "Peak contraction σ0 of scar.", "chosen: 60/90 of the left, as in [Billet2009] §6.2";
    ContractionRate: Mechanics "contraction_rate_per_s" "kATP" ["1/s"] = 10.0 in 0.5..100.0, "Contraction rate kATP.", "5-15 1/s";
    RelaxationRate: Mechanics "relaxation_rate_per_s" "kRS" ["1/s"] = 15.0 in 0.5..200.0, "Relaxation rate kRS.", "chosen; 20-30 1/s where the wall is softer and recoils less";
    FibreStiffness: Mechanics "fibre_stiffness_kpa" "E_f" ["kPa"] = 100.0 in 0.1..2000.0, "Young's modulus E_f along the fibre.", "chosen; 15-75 kPa are published, but linear kinematics take twist for growth and want a stiffer wall";
    TransverseStiffness: Mechanics "transverse_stiffness_kpa" "E_t" ["kPa"] = 60.0 in 0.1..2000.0, "Young's modulus E_t across the fibre.", "chosen with the fibre stiffness; 5-60 kPa are published";
    PoissonRatio: Mechanics "poisson_ratio" "ν" ["1"] = 0.4 in 0.0..0.49, "Poisson's ratio ν, along and across.", "0.4-0.45 with linear tetrahedra";
    VolumeStiffness: Mechanics "volume_stiffness_kpa" "κ_V" ["kPa"] = 0.0 in 0.0..5000.0, "Resistance κ to a change of volume beyond that of ν: κ/2 (J − 1)², in linear kinematics κ/2 (tr ε)².", "off; 350-1000 in codes of finite strain, [Land2015]";
    Density: Mechanics "density_kg_per_mm3" "density" ["kg/mm³"] = 1.06e-6 in 1e-7..1e-5, "Mass density of the myocardium.", "1060 kg/m³";
    DampingMass: Mechanics "damping_mass_per_s" "α" ["1/s"] = 10.0 in 0.0..1000.0, "Rayleigh damping α on the mass.", "chosen";
    DampingStiffness: Mechanics "damping_stiffness_s" "β" ["s"] = 0.01 in 0.0..0.2, "Rayleigh damping β on the stiffness.", "0.005-0.02 s";
    BaseStiffnessNormal: Mechanics "base_stiffness_normal_kpa_per_mm" "k_base_n" ["kPa/mm"] = 2.5 in 0.0..1000.0, "Base springs along the normal.", "[Hirschvogel2017]";
    BaseStiffnessIsotropic: Mechanics "base_stiffness_isotropic_kpa_per_mm" "k_base" ["kPa/mm"] = 2.5 in 0.0..1000.0, "Base springs in all directions; stiffer than published because linear kinematics need it.", "[Hirschvogel2017] 0.25";
    PericardiumStiffness: Mechanics "pericardium_stiffness_kpa_per_mm" "k_peri" ["kPa/mm"] = 0.0 in 0.0..1000.0, "Pericardial springs along the epicardial normal.", "off; [Hirschvogel2017] 0.075";
    PericardiumDamping: Mechanics "pericardium_damping_kpa_s_per_mm" "c_peri" ["kPa·s/mm"] = 0.005 in 0.0..100.0, "Pericardial dashpots along the epicardial normal.", "[Hirschvogel2017]";
    PericardiumBaseShare: Mechanics "pericardium_base_share" "b_peri" ["1"] = 1.0 in 0.0..1.0, "Pericardial springs at the base relative to those at the apex; between them linear in the distance to the base.", "uniform; [Strocchi2020] lets go of the base";
    ValveRingHeight: Mechanics "valve_ring_height_mm" "H_ring" ["mm"] = 0.0 in 0.0..40.0, "Height below the base of the valves' fibrous ring, which is stiff and does not contract; 0 is none.", "off: a base that is held needs none; 5-12 where it is free";
    ValveRingStiffness: Mechanics "valve_ring_stiffness_kpa" "E_ring" ["kPa"] = 300.0 in 0.0..10000.0, "Young's modulus of that ring beyond the muscle's, isotropic.", "chosen; 100-300 differ little";
    ResistanceSystemic: Circulation "resistance_systemic_kpa_s_per_ml" "R_sys" ["kPa·s/mL"] = 0.12 in 0.001..2.0, "Peripheral resistance R of the systemic circulation.", "0.12-0.15";
    ImpedanceSystemic: Circulation "impedance_systemic_kpa_s_per_ml" "Z_sys" ["kPa·s/mL"] = 0.008 in 0.0..0.2, "Characteristic impedance Z of the aorta.", "0.006-0.013";
    ComplianceSystemic: Circulation "compliance_systemic_ml_per_kpa" "C_sys" ["mL/kPa"] = 10.0 in 0.1..200.0, "Compliance C of the systemic arteries.", "8.6-12";
    VenousPressureSystemic: Circulation "venous_pressure_systemic_kpa" "p_v_sys" ["kPa"] = 0.5 in 0.0..5.0, "Pressure behind the systemic resistance.", "RA 0-5 mmHg";
    InitialPressureAorta: Circulation "initial_pressure_aorta_kpa" "p_C_sys(0)" ["kPa"] = 10.0 in 0.0..30.0, "Aortic pressure p_C at the start of the first beat.", "[Hirschvogel2017] 9.68";
    ResistancePulmonary: Circulation "resistance_pulmonary_kpa_s_per_ml" "R_pul" ["kPa·s/mL"] = 0.015 in 0.0005..0.5, "Resistance R of the pulmonary circulation.", "[Hirschvogel2017]";
    ImpedancePulmonary: Circulation "impedance_pulmonary_kpa_s_per_ml" "Z_pul" ["kPa·s/mL"] = 0.0015 in 0.0..0.05, "Characteristic impedance Z of the pulmonary artery.", "0.001-0.002";
    CompliancePulmonary: Circulation "compliance_pulmonary_ml_per_kpa" "C_pul" ["mL/kPa"] = 30.0 in 0.5..500.0, "Compliance C of the pulmonary arteries.", "20-110";
    VenousPressurePulmonary: Circulation "venous_pressure_pulmonary_kpa" "p_v_pul" ["kPa"] = 1.0 in 0.0..5.0, "Pressure behind the pulmonary resistance.", "LA 4-12 mmHg";
    InitialPressurePulmonary: Circulation "initial_pressure_pulmonary_kpa" "p_C_pul(0)" ["kPa"] = 2.0 in 0.0..20.0, "Pulmonary-artery pressure p_C at the start of the first beat.", "PA 8-15 mmHg diastolic";
    AtrialPressureLeft: Circulation "atrial_pressure_left_kpa" "p_LA" ["kPa"] = 1.0 in 0.0..6.0, "Left atrial pressure outside the kick.", "LA 4-12 mmHg";
    AtrialPressureRight: Circulation "atrial_pressure_right_kpa" "p_RA" ["kPa"] = 0.4 in 0.0..4.0, "Right atrial pressure outside the kick.", "RA 0-5 mmHg";
    AtrialKickLeft: Circulation "atrial_kick_left_kpa" "Δp_LA" ["kPa"] = 0.5 in 0.0..4.0, "Height of the left atrial kick.", "chosen";
    AtrialKickRight: Circulation "atrial_kick_right_kpa" "Δp_RA" ["kPa"] = 0.3 in 0.0..4.0, "Height of the right atrial kick.", "chosen";
    AtrialKickDuration: Circulation "atrial_kick_duration_s" "T_kick" ["s"] = 0.12 in 0.01..0.4, "Duration of the atrial kick.", "about 0.1 s";
    AtrialKickOverlap: Circulation "atrial_kick_overlap_s" "t_kick" ["s"] = 0.05 in -0.3..0.3, "How long the atrial kick outlasts the onset of the ventricles, whose pressure then shuts the valve.", "chosen: isovolumetric contraction of 40 ms, not of 95 ms as where the kick ends with the onset";
    ValveResistance: Circulation "valve_resistance_kpa_s_per_ml" "R_valve" ["kPa·s/mL"] = 0.002 in 1e-6..0.1, "Resistance of an open valve.", "chosen: 1 kPa at 500 mL/s";
    ImageGainEndocardiumLv: Tracking "image_gain_endocardium_lv_kpa_per_mm" "γ_LV" ["kPa/mm"] = 20.0 in 0.0..1e4, "Image gain γ per area on the LV endocardium.", "chosen from held-out boundary points";
    ImageGainEndocardiumRv: Tracking "image_gain_endocardium_rv_kpa_per_mm" "γ_RV" ["kPa/mm"] = 20.0 in 0.0..1e4, "Image gain γ per area on the RV endocardium.", "chosen from held-out boundary points";
    ImageGainEpicardium: Tracking "image_gain_epicardium_kpa_per_mm" "γ_epi" ["kPa/mm"] = 20.0 in 0.0..1e4, "Image gain γ per area on the epicardium.", "chosen from held-out boundary points";
    ImageGainBase: Tracking "image_gain_base_kpa_per_mm" "γ_base" ["kPa/mm"] = 5.0 in 0.0..1e4, "Gain per area of the block-matched base.", "chosen";
}

/// One value a parameter, always within its physical range; and the values of parts of the heart that differ.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    values: Vec<f64>,
    regional: BTreeMap<RegionalParameter, f64>,
}

/// A value outside the physical range of its parameter.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{name} = {value} is outside its physical range {lower} to {upper} {unit}")]
pub struct OutOfRange {
    /// Name of the parameter.
    pub name: &'static str,
    /// The value refused.
    pub value: f64,
    /// Smallest value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// Unit.
    pub unit: &'static str,
}

impl Parameter {
    /// The parameter with a name, if there is one.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|parameter| parameter.spec().name == name)
    }
}

impl Default for Parameters {
    fn default() -> Self {
        Self { values: Parameter::ALL.iter().map(|parameter| parameter.spec().default).collect(), regional: BTreeMap::new() }
    }
}

impl Parameters {
    /// Sets a value, in the whole heart or in one part.
    ///
    /// # Errors
    /// [`OutOfRange`] if the value is not finite or outside the physical range.
    pub fn set(&mut self, parameter: impl Into<RegionalParameter>, value: f64) -> Result<(), OutOfRange> {
        let regional: RegionalParameter = parameter.into();
        let &ParameterSpec { name, unit, lower, upper, .. } = regional.parameter().spec();
        if !(lower..=upper).contains(&value) {
            return Err(OutOfRange { name, value, lower, upper, unit });
        }
        match regional.part() {
            Part::Whole => self.values[regional.parameter() as usize] = value,
            _ => drop(self.regional.insert(regional, value)),
        }
        Ok(())
    }

    /// These parameters with one value changed.
    ///
    /// # Errors
    /// [`OutOfRange`] as for [`Parameters::set`].
    pub fn with(mut self, parameter: impl Into<RegionalParameter>, value: f64) -> Result<Self, OutOfRange> {
        self.set(parameter, value)?;
        Ok(self)
    }

    /// Every value: of the whole heart in the order of the table, then of the parts that differ.
    pub fn all_values(&self) -> impl Iterator<Item = (RegionalParameter, f64)> + '_ {
        let whole = Parameter::ALL.iter().map(|&parameter| (RegionalParameter::from(parameter), self[parameter]));
        whole.chain(self.regional.iter().map(|(&regional, &value)| (regional, value)))
    }

    /// The values that parts of the heart have of their own, in the order of the parts.
    pub fn regional_values(&self, parameter: Parameter) -> impl Iterator<Item = (RegionalParameter, f64)> + '_ {
        let of_parameter = self.regional.iter().filter(move |(regional, _)| regional.parameter() == parameter);
        of_parameter.map(|(&regional, &value)| (regional, value))
    }

    /// Whether a parameter has the same values, bit by bit, everywhere in the heart.
    pub(super) fn agrees_with(&self, other: &Self, parameter: Parameter) -> bool {
        let bits = |parameters: &Self| {
            let own = parameters.regional_values(parameter).map(|(regional, value)| (regional, value.to_bits()));
            (parameters[parameter].to_bits(), own.collect::<Vec<_>>())
        };
        bits(self) == bits(other)
    }
}

impl Index<Parameter> for Parameters {
    type Output = f64;

    fn index(&self, parameter: Parameter) -> &f64 {
        &self.values[parameter as usize]
    }
}

impl Index<RegionalParameter> for Parameters {
    type Output = f64;

    /// The part's own value, else that of the ventricle, else that of the whole heart.
    fn index(&self, regional: RegionalParameter) -> &f64 {
        let wider = match regional.part() {
            Part::Segment(_) => RegionalParameter::new(regional.parameter(), Part::LeftVentricle),
            _ => None,
        };
        let own = self.regional.get(&regional).or_else(|| self.regional.get(&wider?));
        own.unwrap_or(&self[regional.parameter()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_default_lies_in_its_physical_range_and_names_are_unique() {
        let mut names = std::collections::BTreeSet::new();
        for &parameter in Parameter::ALL {
            let spec = parameter.spec();
            assert!((spec.lower..=spec.upper).contains(&spec.default), "{}", spec.name);
            assert!(names.insert(spec.name), "{} stands twice", spec.name);
            assert_eq!(Parameter::from_name(spec.name), Some(parameter));
        }
    }

    #[test]
    fn values_out_of_range_are_refused() {
        let error = Parameters::default().with(Parameter::PoissonRatio, 0.5).unwrap_err();
        assert_eq!(error.to_string(), "poisson_ratio = 0.5 is outside its physical range 0 to 0.49 1");
        assert!(Parameters::default().with(Parameter::HeartPeriod, f64::NAN).is_err());
    }
}
