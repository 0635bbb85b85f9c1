//! Closed contours of least energy on all frames of a beat: exact along the circle by dynamic programming, frame after frame until nothing
//! changes.

/// Price α of a difference between neighbouring angles and β of one between neighbouring frames, per step².
const BEND: f64 = 0.05;
const MOTION: f64 = 0.05;

/// Neighbouring angles differ by no more than this many steps.
const REACH: usize = 6;

/// Rounds over the frames; few are needed.
const ROUNDS_MAX: usize = 12;

/// The place on every ray (frames × angles) for costs (frames × angles × places).
pub(super) fn least_energy(cost: &[Vec<Vec<f64>>]) -> Vec<Vec<usize>> {
    let frame_count = cost.len();
    let mut rings: Vec<Vec<usize>> = cost.iter().map(|frame| least_ring(frame)).collect();
    for _ in 0..ROUNDS_MAX {
        let mut is_settled = true;
        for frame in 0..frame_count {
            let neighbours = [&rings[(frame + frame_count - 1) % frame_count], &rings[(frame + 1) % frame_count]];
            let pulled = |(angle, places): (usize, &Vec<f64>)| {
                let pull = |place: usize| neighbours.iter().map(|ring| MOTION * squared_distance(place, ring[angle])).sum::<f64>();
                places.iter().enumerate().map(|(place, cost)| cost + pull(place)).collect()
            };
            let pulled: Vec<Vec<f64>> = cost[frame].iter().enumerate().map(pulled).collect();
            let ring = least_ring(&pulled);
            // Cutting the circle open may miss the optimum; the energy must not rise.
            if ring != rings[frame] && energy(&pulled, &ring) < energy(&pulled, &rings[frame]) {
                rings[frame] = ring;
                is_settled = false;
            }
        }
        if is_settled {
            break;
        }
    }
    rings
}

fn squared_distance(a: usize, b: usize) -> f64 {
    (a.abs_diff(b) as f64).powi(2)
}

fn energy(cost: &[Vec<f64>], ring: &[usize]) -> f64 {
    let places: f64 = cost.iter().zip(ring).map(|(places, &place)| places[place]).sum();
    let bends: f64 = ring.iter().zip(ring.iter().cycle().skip(1)).map(|(&a, &b)| squared_distance(a, b)).sum();
    places + BEND * bends
}

/// The closed contour of least cost of one frame: the middle third of the best open contour thrice round.
fn least_ring(cost: &[Vec<f64>]) -> Vec<usize> {
    let (angles, places) = (cost.len(), cost[0].len());
    let mut best = cost[0].clone();
    let mut came_from: Vec<Vec<usize>> = Vec::with_capacity(3 * angles);
    for turn in 1..3 * angles {
        let mut next = Vec::with_capacity(places);
        let mut from = Vec::with_capacity(places);
        for place in 0..places {
            let near = place.saturating_sub(REACH)..(place + REACH + 1).min(places);
            let price = |other: usize| best[other] + BEND * squared_distance(place, other);
            let (lowest, origin) = near
                .map(|other| (price(other), other))
                .fold((f64::INFINITY, place), |least, one| if one.0 < least.0 { one } else { least });
            next.push(lowest + cost[turn % angles][place]);
            from.push(origin);
        }
        best = next;
        came_from.push(from);
    }
    let mut place = (0..places).fold(0, |least, one| if best[one] < best[least] { one } else { least });
    let mut ring = vec![0; angles];
    for turn in (0..3 * angles).rev() {
        if turn / angles == 1 {
            ring[turn % angles] = place;
        }
        if turn > 0 {
            place = came_from[turn - 1][place];
        }
    }
    ring
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    /// Three angles, four places: all 64 closed contours can be tried.
    #[test]
    fn the_closed_contour_is_the_best_of_all() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for _ in 0..50 {
            let cost: Vec<Vec<f64>> = (0..3).map(|_| (0..4).map(|_| random.random_range(0.0..0.3)).collect()).collect();
            let all = (0..64).map(|n| energy(&cost, &[n % 4, n / 4 % 4, n / 16]));
            let least = all.fold(f64::INFINITY, f64::min);
            // Opened thrice round, the contour is nearly always the best; it is never far from it.
            assert!(energy(&cost, &least_ring(&cost)) < least + 0.05, "{} {least}", energy(&cost, &least_ring(&cost)));
        }
    }

    #[test]
    fn a_frame_without_a_boundary_lies_between_its_neighbours() {
        let frame =
            |at: Option<usize>| vec![(0..20).map(|place| if at.is_none_or(|at| at == place) { 0.0 } else { 5.0 }).collect::<Vec<f64>>(); 8];
        let cost = [frame(Some(6)), frame(None), frame(Some(10)), frame(Some(8))];
        let rings = least_energy(&cost);
        assert_eq!(rings, [vec![6; 8], vec![8; 8], vec![10; 8], vec![8; 8]]);
    }
}
