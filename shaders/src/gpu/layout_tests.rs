//! Tests of kernels without a GPU: the text is valid, and its blocks of constants are laid out as the Rust structs.

use naga::valid::Capabilities;

use super::binding::ALIGNMENT;
use super::joined::{self, FEWEST_ARRAYS};
use super::parts::text::in_parts;

/// The fields of a block of constants, as [`super::uniforms`] lists them.
pub(crate) trait Fields {
    const NAME: &'static str;
    fn offsets() -> Vec<(&'static str, usize)>;
}

/// Parses and validates a kernel without optional features, also with all of its arrays in parts and with joined inputs.
pub(crate) fn validate(source: &str) -> Result<naga::Module, String> {
    validate_with(source, Capabilities::empty())
}

fn validate_with(source: &str, capabilities: Capabilities) -> Result<naga::Module, String> {
    let arrays = source.matches("var<storage,").count();
    validate_text(&in_parts(source, &vec![3; arrays], ALIGNMENT), capabilities)?;
    validate_text(&joined::text(source, arrays), capabilities)?;
    validate_text(source, capabilities)
}

/// Parses and validates WGSL.
pub(crate) fn validate_text(source: &str, capabilities: Capabilities) -> Result<naga::Module, String> {
    let module = naga::front::wgsl::parse_str(source).map_err(|error| error.emit_to_string(source))?;
    let mut validator = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities);
    validator.validate(&module).map_err(|error| format!("{error:?}"))?;
    Ok(module)
}

/// An error unless the kernel's struct `T::NAME` has the size of `T` and its fields at the same offsets.
pub(crate) fn check_layout<T: Fields>(source: &str) -> Result<(), String> {
    compare_layout::<T>(&validate(source)?)
}

fn compare_layout<T: Fields>(module: &naga::Module) -> Result<(), String> {
    let named = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(T::NAME));
    let Some((_, naga::Type { inner: naga::TypeInner::Struct { members, span }, .. })) = named else {
        return Err(format!("the kernel has no struct {}", T::NAME));
    };
    let found: Vec<(&str, usize)> = members
        .iter()
        .map(|member| (member.name.as_deref().unwrap_or("without name"), member.offset as usize))
        .collect();
    if found != T::offsets() || *span as usize != size_of::<T>() {
        let (span, offsets, size) = (*span, T::offsets(), size_of::<T>());
        return Err(format!("{}: {found:?} and {span} bytes instead of {offsets:?} and {size}", T::NAME));
    }
    Ok(())
}

/// An error if a kernel writes more arrays than every adapter allows besides the joined inputs.
fn check_written(source: &str) -> Result<(), String> {
    let written = source.matches("var<storage, read_write>").count();
    if written < FEWEST_ARRAYS as usize { Ok(()) } else { Err(format!("it writes {written} arrays")) }
}

/// Panics unless a kernel that uses subgroups is valid and has the block of constants `T`.
pub(crate) fn assert_valid_with_subgroups<T: Fields>(kernel: &super::Kernel, specialisation: &[(&str, u32)]) {
    let source = kernel.source(specialisation);
    let module = validate_with(&source, Capabilities::SUBGROUP);
    module
        .and_then(|module| compare_layout::<T>(&module).and_then(|()| check_written(&source)))
        .unwrap_or_else(|error| panic!("{}: {error}", kernel.name));
}

/// Panics unless a kernel is valid and has the block of constants `T`.
pub(crate) fn assert_valid<T: Fields>(kernel: &super::Kernel, specialisation: &[(&str, u32)]) {
    let source = kernel.source(specialisation);
    check_layout::<T>(&source)
        .and_then(|()| check_written(&source))
        .unwrap_or_else(|error| panic!("{}: {error}", kernel.name));
}
