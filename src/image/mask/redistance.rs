//! True distances from a level-set function: near its zero level φ/|∇φ|, beyond by fast sweeping of |∇d| = 1 (Zhao 2005).

/// Nodes whose estimated distance is below this many steps keep it; all others are swept.
const BAND_STEPS: f64 = 1.5;

/// Replaces `values` (i fastest, nodes `step_mm` apart) by signed distances, mm, to their zero level.
pub(super) fn to_signed_distance_mm(values: &mut [f64], shape: [usize; 3], step_mm: f64) {
    let near = near_distances(values, shape, step_mm);
    let mut distance: Vec<f64> = near.iter().map(|near| near.map_or(f64::INFINITY, f64::abs)).collect();
    // One round: the characteristics of a distance are straight, so that each lies along one of the eight sweeps.
    for direction in 0..8 {
        sweep(&mut distance, &near, shape, step_mm, direction);
    }
    for (flat, value) in values.iter_mut().enumerate() {
        let signed = near[flat].unwrap_or(distance[flat].copysign(*value));
        // Without any zero level nothing is reached: keep the sign and a distance larger than the grid.
        let farthest = step_mm * shape.iter().sum::<usize>() as f64;
        *value = signed.clamp(-farthest, farthest);
    }
}

fn near_distances(values: &[f64], shape: [usize; 3], step_mm: f64) -> Vec<Option<f64>> {
    let strides = [1, shape[0], shape[0] * shape[1]];
    let estimate = |flat: usize| {
        let mut slope_squared = 0.0;
        let mut touches_zero = false;
        for axis in 0..3 {
            let at = flat / strides[axis] % shape[axis];
            let behind = if at > 0 { flat - strides[axis] } else { flat };
            let ahead = if at + 1 < shape[axis] { flat + strides[axis] } else { flat };
            let nodes = ((ahead - behind) / strides[axis]).max(1) as f64;
            slope_squared += ((values[ahead] - values[behind]) / (nodes * step_mm)).powi(2);
            touches_zero |= (values[ahead] < 0.0) != (values[flat] < 0.0) || (values[behind] < 0.0) != (values[flat] < 0.0);
        }
        // At ridges the slope vanishes without the zero level being near.
        let distance = values[flat] / slope_squared.sqrt().max(0.3);
        (touches_zero || distance.abs() < BAND_STEPS * step_mm).then_some(distance)
    };
    (0..values.len()).map(estimate).collect()
}

/// One Gauss–Seidel sweep; the bits of `direction` say which axes run backwards.
fn sweep(distance: &mut [f64], fixed: &[Option<f64>], shape: [usize; 3], step_mm: f64, direction: usize) {
    let order = |axis: usize, n: usize| if direction >> axis & 1 == 0 { n } else { shape[axis] - 1 - n };
    let strides = [1, shape[0], shape[0] * shape[1]];
    for c in 0..shape[2] {
        for b in 0..shape[1] {
            for a in 0..shape[0] {
                let at = [order(0, a), order(1, b), order(2, c)];
                let flat = at[0] + strides[1] * at[1] + strides[2] * at[2];
                if fixed[flat].is_some() {
                    continue;
                }
                let upwind = [0, 1, 2].map(|axis| {
                    let behind = if at[axis] > 0 { distance[flat - strides[axis]] } else { f64::INFINITY };
                    let ahead = if at[axis] + 1 < shape[axis] { distance[flat + strides[axis]] } else { f64::INFINITY };
                    behind.min(ahead)
                });
                let [least, middle, most] = ascending(upwind);
                if least < distance[flat] {
                    distance[flat] = distance[flat].min(godunov([least, middle, most], step_mm));
                }
            }
        }
    }
}

fn ascending([a, b, c]: [f64; 3]) -> [f64; 3] {
    let (low, high) = (a.min(b), a.max(b));
    [low.min(c), high.min(low.max(c)), high.max(c)]
}

/// The smallest d with Σₐ max(d − uₐ, 0)² = h², for ascending upwind values u.
fn godunov(upwind: [f64; 3], step_mm: f64) -> f64 {
    let [a, b, c] = upwind;
    let one = a + step_mm;
    if one <= b {
        return one;
    }
    let two = 0.5 * (a + b + (2.0 * step_mm * step_mm - (a - b).powi(2)).max(0.0).sqrt());
    if two <= c {
        return two;
    }
    let sum = a + b + c;
    let discriminant = sum * sum - 3.0 * (a * a + b * b + c * c - step_mm * step_mm);
    (sum + discriminant.max(0.0).sqrt()) / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_squared_ellipsoid_function_becomes_a_distance_and_keeps_its_zero_level() {
        let (shape, step_mm, radius_mm) = ([41, 41, 41], 1.0, 13.0);
        let centre = [20.2, 19.7, 20.4];
        let exact = |flat: usize| {
            let at = [flat % 41, flat / 41 % 41, flat / 1681];
            (0..3).map(|axis| (at[axis] as f64 - centre[axis]).powi(2)).sum::<f64>().sqrt() - radius_mm
        };
        let mut values: Vec<f64> = (0..41 * 41 * 41).map(|flat| exact(flat) * (2.0 * radius_mm + exact(flat)) / radius_mm).collect();
        to_signed_distance_mm(&mut values, shape, step_mm);
        for (flat, value) in values.iter().enumerate() {
            let error = (value - exact(flat)).abs();
            // First order: a twentieth of a step in the band, a fraction of a step beyond it, more where fronts meet at the centre.
            let tolerance = if exact(flat).abs() < 1.0 {
                0.05
            } else if exact(flat) > -8.0 {
                0.6
            } else {
                1.5
            };
            assert!(error < tolerance, "distance {} error {error}", exact(flat));
        }
    }

    #[test]
    fn nothing_inside_stays_outside() {
        let mut values = vec![1.0; 27];
        to_signed_distance_mm(&mut values, [3, 3, 3], 1.0);
        assert!(values.iter().all(|v| *v > 0.0 && v.is_finite()));
    }
}
