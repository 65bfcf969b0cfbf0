//! How the kernels run.

/// Choices that change no image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Whether pixels skip the entries that do not meet their cell of the tile.
    pub is_culled: bool,
}

#[cfg(test)]
thread_local! {
    /// What a test changes, on its own thread as tests run side by side.
    static CHANGE: std::cell::Cell<Option<fn(&mut Plan)>> = const { std::cell::Cell::new(None) };
}

impl Plan {
    /// What is fastest.
    pub fn new() -> Self {
        #[cfg_attr(not(test), expect(unused_mut))]
        let mut plan = Self { is_culled: true };
        #[cfg(test)]
        if let Some(change) = CHANGE.get() {
            change(&mut plan);
        }
        plan
    }

    /// Runs kernels by a changed plan.
    #[cfg(test)]
    pub fn changed<R>(change: fn(&mut Self), run: impl FnOnce() -> R) -> R {
        CHANGE.set(Some(change));
        let result = run();
        CHANGE.set(None);
        result
    }
}
