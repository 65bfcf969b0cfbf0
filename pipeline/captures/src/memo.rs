//! A cache of values that are computed at most once per view.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// Values by view index, each computed at its first use and kept; `None` for views without a value.
pub struct Memo<T, F> {
    compute: F,
    known: RefCell<BTreeMap<usize, Option<Rc<T>>>>,
}

impl<T, F: Fn(usize) -> anyhow::Result<Option<T>>> Memo<T, F> {
    /// Values that `compute` returns.
    pub fn new(compute: F) -> Self {
        Self { compute, known: RefCell::default() }
    }

    /// The value of a view, if it has one.
    pub fn get(&self, view: usize) -> anyhow::Result<Option<Rc<T>>> {
        if let Some(known) = self.known.borrow().get(&view) {
            return Ok(known.clone());
        }
        let computed = (self.compute)(view)?.map(Rc::new);
        self.known.borrow_mut().insert(view, computed.clone());
        Ok(computed)
    }
}
