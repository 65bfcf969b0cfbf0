//! Fits launches to the limits of their adapter: large arrays come in parts, and inputs are joined if a kernel has too many.

use super::Gpu;
use super::joined::{self, Joined};
use super::launch::Launch;
use super::parts::Parts;

impl Gpu {
    /// Records a kernel. It runs after everything recorded before; nothing runs for zero workgroups. Arrays that are
    /// larger than a binding are bound in parts, and inputs are joined if the adapter allows too few arrays; panics with a
    /// [`super::GpuFailure`] if there are still too many.
    pub(crate) fn launch(self, launch: &Launch) {
        if launch.groups.is_empty() {
            return;
        }
        for binding in launch.arrays {
            assert!(binding.gpu() == self, "{}: another GPU", launch.name);
        }
        if let Some(parts) = Parts::of(self, launch.kernel(), launch.arrays) {
            let (name, source) = (launch.name.clone() + &parts.name(), || parts.text(&(launch.source)()));
            self.record(&Launch { name, source: &source, arrays: &parts.bindings, ..*launch });
        } else if let Some(joined) = Joined::of(self, launch.kernel(), launch.arrays) {
            let arrays = launch.arrays.len();
            let (name, source) = (launch.name.clone() + " [joined]", || joined::text(&(launch.source)(), arrays));
            self.record(&Launch { name, source: &source, arrays: &joined.bindings(launch.arrays), ..*launch });
        } else {
            self.record(launch);
        }
    }
}
