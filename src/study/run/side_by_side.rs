//! Many tasks of one kind on the threads of this machine, each on threads of its own.

use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::error::RunError;

/// Does `task` for every item, in their order, as many side by side as there are threads; ends early once `is_stopped` or a task failed, with
/// the first failure.
///
/// A task keeps to its own threads: work stealing among all of them would begin many tasks before it ends one, and hold all in memory.
pub(in crate::study) fn side_by_side<T: Sync>(
    items: &[T],
    is_stopped: impl Fn() -> bool + Sync,
    task: impl Fn(&T) -> Result<(), RunError> + Sync,
) -> Result<(), RunError> {
    let thread_count = rayon::current_num_threads();
    let worker_count = thread_count.min(items.len());
    let next = AtomicUsize::new(0);
    let failure = Mutex::new(None);
    let has_failed = || failure.lock().unwrap_or_else(PoisonError::into_inner).is_some();
    let work = || {
        let threads = rayon::ThreadPoolBuilder::new().num_threads((thread_count / worker_count).max(1)).build();
        let threads = threads.map_err(|error| RunError::Threads { reason: error.to_string() })?;
        while let Some(item) = items.get(next.fetch_add(1, Ordering::Relaxed)).filter(|_| !is_stopped() && !has_failed()) {
            threads.install(|| task(item))?;
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        for _ in 0..worker_count {
            scope.spawn(|| {
                if let Err(error) = work() {
                    failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                }
            });
        }
    });
    failure.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_is_done_once_and_a_failure_ends_it() {
        let done = Mutex::new(Vec::new());
        let items: Vec<usize> = (0..100).collect();
        let note = |&item: &usize| {
            done.lock().unwrap().push(item);
            Ok(())
        };
        side_by_side(&items, || false, note).unwrap();
        let mut done = done.into_inner().unwrap();
        done.sort_unstable();
        assert_eq!(done, items);
        let count = AtomicUsize::new(0);
        let failing = |&item: &usize| {
            count.fetch_add(1, Ordering::Relaxed);
            if item == 3 { Err(RunError::Stopped) } else { Ok(()) }
        };
        assert!(side_by_side(&items, || false, failing).is_err());
        assert!(count.into_inner() < 100);
        side_by_side(&items, || true, |_| Err(RunError::Stopped)).unwrap();
    }
}
