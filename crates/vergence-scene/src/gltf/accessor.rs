//! Reads accessors: every offset, stride and count is checked before a byte is touched or allocated.

use std::path::Path;

use super::container::Buffer;
use super::raw;
use crate::Error;
use crate::import::Import;

/// What an accessor's numbers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn from_gl(value: u32) -> Option<Self> {
        Some(match value {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// `bytes` holds at least [`Self::size`] bytes.
    fn float(self, bytes: &[u8], normalized: bool) -> f32 {
        let scaled = |value: f32, largest: f32| if normalized { (value / largest).max(-1.0) } else { value };
        match self {
            Self::I8 => scaled(f32::from(bytes[0] as i8), 127.0),
            Self::U8 => scaled(f32::from(bytes[0]), 255.0),
            Self::I16 => scaled(f32::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32767.0),
            Self::U16 => scaled(f32::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65535.0),
            Self::U32 => self.integer(bytes) as f32,
            Self::F32 => f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        }
    }

    /// For unsigned components; `bytes` holds at least [`Self::size`] bytes.
    fn integer(self, bytes: &[u8]) -> u32 {
        match self.size() {
            1 => u32::from(bytes[0]),
            2 => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            _ => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        }
    }

    fn is_unsigned(self) -> bool {
        matches!(self, Self::U8 | Self::U16 | Self::U32)
    }
}

fn components_of(kind: &str) -> Option<usize> {
    Some(match kind {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" => 4,
        "MAT4" => 16,
        _ => return None,
    })
}

/// The accessors of one file.
pub(super) struct Accessors<'a> {
    pub path: &'a Path,
    pub root: &'a raw::Root,
    pub buffers: &'a [Option<Buffer>],
}

/// Elements in a buffer: `count` of them, `stride` bytes apart, all inside `bytes`.
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    component: Component,
}

impl Elements<'_> {
    fn at(&self, index: usize) -> &[u8] {
        &self.bytes[index * self.stride..]
    }
}

impl Accessors<'_> {
    fn invalid(&self, place: impl std::fmt::Display, message: impl std::fmt::Display) -> Error {
        Error::invalid(self.path, place, message)
    }

    /// The bytes of a buffer view and its stride.
    pub fn view(&self, index: usize, place: &str) -> Result<(&[u8], Option<usize>), Error> {
        let view = self.root.buffer_views.get(index).ok_or_else(|| {
            self.invalid(
                place,
                format!("expected a buffer view below {}, found {index}", self.root.buffer_views.len()),
            )
        })?;
        let place = format!("bufferViews[{index}]");
        let buffer = self.buffers.get(view.buffer).and_then(Option::as_ref).ok_or_else(|| {
            self.invalid(
                format!("{place}.buffer"),
                format!("expected a buffer below {}, found {}", self.buffers.len(), view.buffer),
            )
        })?;
        let bytes = buffer.bytes();
        let end = view.byte_offset.checked_add(view.byte_length).filter(|&end| end <= bytes.len() as u64);
        let Some(end) = end else {
            return Err(self.invalid(
                place,
                format!(
                    "expected at most {} bytes (those of buffers[{}]), found {} from byte {}",
                    bytes.len(),
                    view.buffer,
                    view.byte_length,
                    view.byte_offset
                ),
            ));
        };
        let stride = match view.byte_stride {
            Some(stride) if stride > 252 => {
                return Err(self.invalid(
                    format!("{place}.byteStride"),
                    format!("expected at most 252 bytes, found {stride}"),
                ));
            }
            stride => stride.map(|stride| stride as usize),
        };
        Ok((&bytes[view.byte_offset as usize..end as usize], stride))
    }

    fn elements(
        &self,
        view: usize,
        offset: u64,
        count: u64,
        component: Component,
        components: usize,
        place: &str,
    ) -> Result<Elements<'_>, Error> {
        let (bytes, stride) = self.view(view, &format!("{place}.bufferView"))?;
        let size = component.size() * components;
        let stride = stride.unwrap_or(size);
        if stride < size && count > 1 {
            return Err(self.invalid(
                format!("bufferViews[{view}].byteStride"),
                format!("expected at least the {size} bytes of an element of {place}, found {stride}"),
            ));
        }
        let last = count.saturating_sub(1).checked_mul(stride as u64);
        let end = last.and_then(|last| last.checked_add(offset)?.checked_add(size as u64));
        if count > 0 && end.is_none_or(|end| end > bytes.len() as u64) {
            return Err(self.invalid(
                place,
                format!(
                    "expected {count} elements of {size} bytes, {stride} apart from byte {offset}, inside the {} \
                     bytes of bufferViews[{view}], found too few",
                    bytes.len()
                ),
            ));
        }
        let bytes = if count == 0 { &[] } else { &bytes[offset as usize..] };
        Ok(Elements { bytes, stride, component })
    }

    /// Reads all elements of accessor `index`, which `place` refers to: dense ones first, then those that a
    /// sparse accessor puts in their places. `convert` gets the component type and one element's bytes.
    fn read<T: Copy + Default>(
        &self,
        import: &mut Import<'_>,
        index: usize,
        place: &str,
        kind: &str,
        allowed: impl Fn(Component, bool) -> bool,
        mut convert: impl FnMut(Component, bool, &[u8]) -> Option<T>,
    ) -> Result<Vec<T>, Error> {
        let accessor = self.get(index, place)?;
        let place = format!("accessors[{index}]");
        if accessor.kind != kind {
            return Err(self
                .invalid(format!("{place}.type"), format!("expected {kind:?}, found {:?}", accessor.kind)));
        }
        let components = components_of(kind).unwrap_or(1);
        let component = self.component(accessor.component_type, &format!("{place}.componentType"))?;
        if !allowed(component, accessor.normalized) {
            let normalized = if accessor.normalized { " (normalized)" } else { "" };
            return Err(self.invalid(
                format!("{place}.componentType"),
                format!("expected another type of numbers here, found {component:?}{normalized}"),
            ));
        }
        let count = usize::try_from(accessor.count)
            .map_err(|_| self.invalid(format!("{place}.count"), "expected a smaller count"))?;
        let finite = |element: usize| {
            self.invalid(format!("{place}, element {element}"), "expected finite numbers, found others")
        };
        // Only what is really there is allocated: a dense accessor's bytes are checked first.
        let dense = match accessor.buffer_view {
            Some(view) => Some(self.elements(
                view,
                accessor.byte_offset,
                accessor.count,
                component,
                components,
                &place,
            )?),
            None => None,
        };
        import.charge(self.path, format!("{place}.count"), count, size_of::<T>())?;
        let mut values = Vec::with_capacity(count);
        match dense {
            Some(dense) => {
                for element in 0..count {
                    let value = convert(dense.component, accessor.normalized, dense.at(element));
                    values.push(value.ok_or_else(|| finite(element))?);
                }
            }
            None => values.resize(count, T::default()),
        }
        if let Some(sparse) = &accessor.sparse {
            let place = format!("{place}.sparse");
            if sparse.count > accessor.count {
                return Err(self.invalid(
                    format!("{place}.count"),
                    format!("expected at most {}, found {}", accessor.count, sparse.count),
                ));
            }
            let indices_place = format!("{place}.indices");
            let index_type =
                self.component(sparse.indices.component_type, &format!("{indices_place}.componentType"))?;
            if !index_type.is_unsigned() {
                return Err(
                    self.invalid(indices_place, format!("expected unsigned integers, found {index_type:?}"))
                );
            }
            let indices = self.elements(
                sparse.indices.buffer_view,
                sparse.indices.byte_offset,
                sparse.count,
                index_type,
                1,
                &indices_place,
            )?;
            let replacements = self.elements(
                sparse.values.buffer_view,
                sparse.values.byte_offset,
                sparse.count,
                component,
                components,
                &format!("{place}.values"),
            )?;
            for element in 0..sparse.count as usize {
                let target = index_type.integer(indices.at(element)) as usize;
                let slot = values.get_mut(target).ok_or_else(|| {
                    self.invalid(
                        format!("{indices_place}, element {element}"),
                        format!("expected an index below {count}, found {target}"),
                    )
                })?;
                *slot = convert(component, accessor.normalized, replacements.at(element))
                    .ok_or_else(|| finite(target))?;
            }
        }
        Ok(values)
    }

    fn component(&self, value: u32, place: &str) -> Result<Component, Error> {
        Component::from_gl(value).ok_or_else(|| {
            self.invalid(place, format!("expected 5120, 5121, 5122, 5123, 5125 or 5126, found {value}"))
        })
    }

    /// The accessor `index`, which `place` refers to.
    pub fn get(&self, index: usize, place: &str) -> Result<&raw::Accessor, Error> {
        self.root.accessors.get(index).ok_or_else(|| {
            self.invalid(
                place,
                format!("expected an accessor below {}, found {index}", self.root.accessors.len()),
            )
        })
    }

    /// `N` finite numbers per element; integers are taken as they are, or normalised where the accessor says so.
    pub fn floats<const N: usize>(
        &self,
        import: &mut Import<'_>,
        index: usize,
        place: &str,
    ) -> Result<Vec<[f32; N]>, Error>
    where
        [f32; N]: Default,
    {
        let kind = match N {
            2 => "VEC2",
            3 => "VEC3",
            4 => "VEC4",
            _ => "MAT4",
        };
        self.read(
            import,
            index,
            place,
            kind,
            |component, _| component != Component::U32,
            |component, normalized, bytes| {
                let size = component.size();
                let value: [f32; N] =
                    std::array::from_fn(|i| component.float(&bytes[i * size..], normalized));
                value.iter().all(|v| v.is_finite()).then_some(value)
            },
        )
    }

    /// One finite `f32` per element.
    pub fn scalars(&self, import: &mut Import<'_>, index: usize, place: &str) -> Result<Vec<f32>, Error> {
        self.read(
            import,
            index,
            place,
            "SCALAR",
            |component, _| component == Component::F32,
            |component, _, bytes| Some(component.float(bytes, false)).filter(|v| v.is_finite()),
        )
    }

    /// 4×4 matrices, columns one after the other.
    pub fn matrices(&self, import: &mut Import<'_>, index: usize, place: &str) -> Result<Vec<Matrix>, Error> {
        self.read(
            import,
            index,
            place,
            "MAT4",
            |component, _| component == Component::F32,
            |component, _, bytes| {
                let value = std::array::from_fn(|i| component.float(&bytes[i * 4..], false));
                value.iter().all(|v| v.is_finite()).then_some(Matrix(value))
            },
        )
    }

    /// Vertex indices, each below `vertices`.
    pub fn indices(
        &self,
        import: &mut Import<'_>,
        index: usize,
        place: &str,
        vertices: usize,
    ) -> Result<Vec<u32>, Error> {
        let indices = self.read(
            import,
            index,
            place,
            "SCALAR",
            |component, normalized| component.is_unsigned() && !normalized,
            |component, _, bytes| Some(component.integer(bytes)),
        )?;
        match indices.iter().position(|&i| i as usize >= vertices) {
            Some(at) => Err(self.invalid(
                format!("accessors[{index}], element {at}"),
                format!("expected a vertex index below {vertices}, found {}", indices[at]),
            )),
            None => Ok(indices),
        }
    }

    /// Joint indices, four per vertex.
    pub fn joints(&self, import: &mut Import<'_>, index: usize, place: &str) -> Result<Vec<[u16; 4]>, Error> {
        self.read(
            import,
            index,
            place,
            "VEC4",
            |component, normalized| matches!(component, Component::U8 | Component::U16) && !normalized,
            |component, _, bytes| {
                Some(std::array::from_fn(|i| component.integer(&bytes[i * component.size()..]) as u16))
            },
        )
    }
}

/// A 4×4 matrix, columns one after the other.
#[derive(Clone, Copy)]
pub(super) struct Matrix(pub [f32; 16]);

impl Default for Matrix {
    fn default() -> Self {
        Self([0.0; 16])
    }
}
