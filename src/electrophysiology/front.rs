//! The vertices on the front, earliest first: a four-ary heap that knows where each vertex stands, so its key can fall.

/// Place of a vertex that is not on the front.
const ABSENT: u32 = u32::MAX;

/// A priority queue of vertices by time; equal times leave in the order of the vertices.
#[derive(Debug)]
pub(super) struct Front {
    queue: Vec<(f64, u32)>,
    places: Vec<u32>,
}

impl Front {
    pub(super) fn new(vertex_count: usize) -> Self {
        Self { queue: Vec::new(), places: vec![ABSENT; vertex_count] }
    }

    /// Puts a vertex on the front, or moves it forward to an earlier time.
    pub(super) fn advance(&mut self, vertex: usize, time_s: f64) {
        let entry = (time_s, vertex as u32);
        let place = match self.places[vertex] {
            ABSENT => {
                self.queue.push(entry);
                self.queue.len() - 1
            }
            place => place as usize,
        };
        self.rise(place, entry);
    }

    /// Takes the earliest vertex off the front.
    pub(super) fn pop(&mut self) -> Option<usize> {
        let (_, earliest) = *self.queue.first()?;
        self.places[earliest as usize] = ABSENT;
        if let Some(last) = self.queue.pop()
            && !self.queue.is_empty()
        {
            self.sink(last);
        }
        Some(earliest as usize)
    }

    fn put(&mut self, place: usize, entry: (f64, u32)) {
        self.queue[place] = entry;
        self.places[entry.1 as usize] = place as u32;
    }

    fn rise(&mut self, mut place: usize, entry: (f64, u32)) {
        while place > 0 {
            let parent = (place - 1) / 4;
            if !is_earlier(entry, self.queue[parent]) {
                break;
            }
            self.put(place, self.queue[parent]);
            place = parent;
        }
        self.put(place, entry);
    }

    fn sink(&mut self, entry: (f64, u32)) {
        let mut place = 0;
        loop {
            let first = 4 * place + 1;
            let end = (first + 4).min(self.queue.len());
            let mut child = first;
            for sibling in first + 1..end {
                if is_earlier(self.queue[sibling], self.queue[child]) {
                    child = sibling;
                }
            }
            if child >= end || !is_earlier(self.queue[child], entry) {
                break;
            }
            self.put(place, self.queue[child]);
            place = child;
        }
        self.put(place, entry);
    }
}

fn is_earlier(a: (f64, u32), b: (f64, u32)) -> bool {
    a.0 < b.0 || (a.0 == b.0 && a.1 < b.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_leave_in_the_order_of_their_last_times() {
        let mut front = Front::new(1000);
        let time = |vertex: usize| ((vertex * 7919) % 1009) as f64;
        for vertex in 0..1000 {
            front.advance(vertex, time(vertex) + 5000.0);
        }
        for vertex in (0..1000).step_by(3) {
            front.advance(vertex, time(vertex));
        }
        let mut expected: Vec<usize> = (0..1000).collect();
        expected.sort_by(|&a, &b| {
            let key = |v: usize| time(v) + if v.is_multiple_of(3) { 0.0 } else { 5000.0 };
            key(a).total_cmp(&key(b)).then(a.cmp(&b))
        });
        assert_eq!(std::iter::from_fn(|| front.pop()).collect::<Vec<_>>(), expected);
    }
}
