//! Descriptor sets: written once, when they are made, and kept alive by the commands that use them.

use std::sync::{Arc, Mutex, PoisonError};

use ash::vk;

use crate::buffer::Buffer;
use crate::census::Counters;
use crate::device::Device;
use crate::error::{At, Error};
use crate::image::ImageView;
use crate::sampler::Sampler;

/// Sets allocated from one pool before another one is opened.
const SETS_PER_POOL: u32 = 32;

/// One binding of a set layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BindingDesc {
    /// Number in the shader.
    pub binding: u32,
    /// Kind: uniform or storage buffer (also dynamic), sampled or storage image, sampler.
    pub kind: vk::DescriptorType,
    /// Array length (1 for a plain binding).
    pub count: u32,
    /// Stages that use it.
    pub stages: vk::ShaderStageFlags,
}

impl BindingDesc {
    /// A plain binding (count 1).
    pub const fn new(binding: u32, kind: vk::DescriptorType, stages: vk::ShaderStageFlags) -> Self {
        Self { binding, kind, count: 1, stages }
    }
}

/// The shape of descriptor sets, and the pools that they are allocated from.
pub struct SetLayout {
    pub(crate) raw: vk::DescriptorSetLayout,
    bindings: Vec<BindingDesc>,
    dynamic: u32,
    pools: Mutex<Vec<(vk::DescriptorPool, u32)>>,
    device: Arc<Device>,
}

impl SetLayout {
    /// Makes a set layout.
    ///
    /// # Errors
    ///
    /// When the driver refuses.
    pub fn new(device: &Arc<Device>, bindings: &[BindingDesc]) -> Result<Arc<Self>, Error> {
        let raw_bindings: Vec<_> = bindings
            .iter()
            .map(|b| {
                vk::DescriptorSetLayoutBinding::default()
                    .binding(b.binding)
                    .descriptor_type(b.kind)
                    .descriptor_count(b.count)
                    .stage_flags(b.stages)
            })
            .collect();
        let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&raw_bindings);
        // SAFETY: the create info is complete.
        let raw = unsafe { device.raw.create_descriptor_set_layout(&info, None) }
            .at("vkCreateDescriptorSetLayout")?;
        Counters::add(&device.counters.set_layouts, 1);
        let dynamic = bindings
            .iter()
            .filter(|b| {
                matches!(
                    b.kind,
                    vk::DescriptorType::UNIFORM_BUFFER_DYNAMIC | vk::DescriptorType::STORAGE_BUFFER_DYNAMIC
                )
            })
            .map(|b| b.count)
            .sum();
        Ok(Arc::new(Self {
            raw,
            bindings: bindings.to_vec(),
            dynamic,
            pools: Mutex::default(),
            device: Arc::clone(device),
        }))
    }

    /// The bindings it was made with.
    pub fn bindings(&self) -> &[BindingDesc] {
        &self.bindings
    }

    /// The device that it lives on.
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// How many dynamic offsets its sets are bound with.
    pub(crate) fn dynamic(&self) -> u32 {
        self.dynamic
    }

    /// Allocates a set; says which pool it is from.
    fn allocate(&self) -> Result<(vk::DescriptorSet, vk::DescriptorPool), Error> {
        let mut pools = self.pools.lock().unwrap_or_else(PoisonError::into_inner);
        let at = match pools.iter().position(|(_, used)| *used < SETS_PER_POOL) {
            Some(at) => at,
            None => {
                let sizes: Vec<_> = self
                    .bindings
                    .iter()
                    .filter(|b| b.count > 0)
                    .map(|b| {
                        vk::DescriptorPoolSize::default().ty(b.kind).descriptor_count(b.count * SETS_PER_POOL)
                    })
                    .collect();
                let info = vk::DescriptorPoolCreateInfo::default()
                    .flags(vk::DescriptorPoolCreateFlags::FREE_DESCRIPTOR_SET)
                    .max_sets(SETS_PER_POOL)
                    .pool_sizes(&sizes);
                // SAFETY: the create info is complete.
                let pool = unsafe { self.device.raw.create_descriptor_pool(&info, None) }
                    .at("vkCreateDescriptorPool")?;
                pools.push((pool, 0));
                pools.len() - 1
            }
        };
        let layouts = [self.raw];
        let info =
            vk::DescriptorSetAllocateInfo::default().descriptor_pool(pools[at].0).set_layouts(&layouts);
        // SAFETY: the pool is locked, and has room for a set of this layout.
        let sets =
            unsafe { self.device.raw.allocate_descriptor_sets(&info) }.at("vkAllocateDescriptorSets")?;
        pools[at].1 += 1;
        Ok((sets[0], pools[at].0))
    }

    fn free(&self, set: vk::DescriptorSet, pool: vk::DescriptorPool) {
        let mut pools = self.pools.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the pool is locked; the set is from it and no command uses it any more.
        let _ = unsafe { self.device.raw.free_descriptor_sets(pool, &[set]) };
        if let Some(entry) = pools.iter_mut().find(|(p, _)| *p == pool) {
            entry.1 -= 1;
        }
    }
}

impl Drop for SetLayout {
    fn drop(&mut self) {
        for (pool, _) in self.pools.get_mut().unwrap_or_else(PoisonError::into_inner).drain(..) {
            // SAFETY: every set holds an Arc of the layout, so none is left.
            unsafe { self.device.raw.destroy_descriptor_pool(pool, None) };
        }
        // SAFETY: sets and pipeline layouts hold an Arc of it, so none is left.
        unsafe { self.device.raw.destroy_descriptor_set_layout(self.raw, None) };
        Counters::sub(&self.device.counters.set_layouts, 1);
    }
}

/// What one element of a binding refers to.
#[derive(Clone, Copy)]
pub enum Bound<'a> {
    /// A whole buffer.
    Buffer(&'a Arc<Buffer>),
    /// `size` bytes of a buffer at `offset`; for dynamic bindings the window that moves.
    BufferRange(&'a Arc<Buffer>, u64, u64),
    /// An image that is sampled, in the layout of [`Use::Sampled`](crate::Use::Sampled).
    Sampled(&'a Arc<ImageView>),
    /// An image that is read and written as storage, in the layout of [`Use::Storage`](crate::Use::Storage).
    Storage(&'a Arc<ImageView>),
    /// A depth image that is sampled while it is also a read-only depth attachment.
    SampledDepth(&'a Arc<ImageView>),
    /// A sampler.
    Sampler(&'a Arc<Sampler>),
}

/// Kept alive by a set.
#[expect(dead_code, reason = "held for their destructors only")]
enum Kept {
    Buffer(Arc<Buffer>),
    View(Arc<ImageView>),
    Sampler(Arc<Sampler>),
}

/// A descriptor set; immutable once made.
pub struct DescriptorSet {
    pub(crate) raw: vk::DescriptorSet,
    pool: vk::DescriptorPool,
    layout: Arc<SetLayout>,
    _kept: Vec<Kept>,
}

impl DescriptorSet {
    /// Makes a set with `(binding, array element, what)` written to it. Every element of the layout must be given.
    ///
    /// # Errors
    ///
    /// A binding that the layout does not have or that is of another kind, a missing one, or a range outside of a buffer.
    pub fn new(layout: &Arc<SetLayout>, bound: &[(u32, u32, Bound<'_>)]) -> Result<Arc<Self>, Error> {
        let elements: u32 = layout.bindings.iter().map(|b| b.count).sum();
        let mut given: Vec<(u32, u32)> = bound.iter().map(|(b, e, _)| (*b, *e)).collect();
        given.sort_unstable();
        given.dedup();
        if given.len() != elements as usize {
            return Err(Error::range("elements of a descriptor set", elements, given.len()));
        }
        for &(binding, element, what) in bound {
            check(layout, binding, element, what)?;
        }
        for (_, _, what) in bound {
            layout.device.check_home(match what {
                Bound::Buffer(b) | Bound::BufferRange(b, ..) => b.device(),
                Bound::Sampled(v) | Bound::SampledDepth(v) | Bound::Storage(v) => v.image().device(),
                Bound::Sampler(s) => s.device(),
            })?;
        }
        let (raw, pool) = layout.allocate()?;
        let buffers: Vec<_> = bound
            .iter()
            .map(|(_, _, what)| match what {
                Bound::Buffer(b) => {
                    vk::DescriptorBufferInfo::default().buffer(b.raw).offset(0).range(vk::WHOLE_SIZE)
                }
                Bound::BufferRange(b, offset, size) => {
                    vk::DescriptorBufferInfo::default().buffer(b.raw).offset(*offset).range(*size)
                }
                _ => vk::DescriptorBufferInfo::default(),
            })
            .collect();
        let images: Vec<_> = bound
            .iter()
            .map(|(_, _, what)| {
                let info = vk::DescriptorImageInfo::default();
                match what {
                    Bound::Sampled(v) => {
                        info.image_view(v.raw).image_layout(vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL)
                    }
                    Bound::SampledDepth(v) => {
                        info.image_view(v.raw).image_layout(vk::ImageLayout::DEPTH_STENCIL_READ_ONLY_OPTIMAL)
                    }
                    Bound::Storage(v) => info.image_view(v.raw).image_layout(vk::ImageLayout::GENERAL),
                    Bound::Sampler(s) => info.sampler(s.raw),
                    _ => info,
                }
            })
            .collect();
        let writes: Vec<_> = bound
            .iter()
            .enumerate()
            .map(|(i, (binding, element, what))| {
                let write = vk::WriteDescriptorSet::default()
                    .dst_set(raw)
                    .dst_binding(*binding)
                    .dst_array_element(*element)
                    .descriptor_type(kind_in(layout, *binding));
                match what {
                    Bound::Buffer(_) | Bound::BufferRange(..) => write.buffer_info(&buffers[i..=i]),
                    _ => write.image_info(&images[i..=i]),
                }
            })
            .collect();
        // SAFETY: the set is new, so nothing uses it; bindings and kinds were checked; what they refer to is kept below.
        unsafe { layout.device.raw.update_descriptor_sets(&writes, &[]) };
        let kept = bound
            .iter()
            .map(|(_, _, what)| match what {
                Bound::Buffer(b) | Bound::BufferRange(b, ..) => Kept::Buffer(Arc::clone(b)),
                Bound::Sampled(v) | Bound::SampledDepth(v) | Bound::Storage(v) => Kept::View(Arc::clone(v)),
                Bound::Sampler(s) => Kept::Sampler(Arc::clone(s)),
            })
            .collect();
        Counters::add(&layout.device.counters.sets, 1);
        Ok(Arc::new(Self { raw, pool, layout: Arc::clone(layout), _kept: kept }))
    }

    /// The shape of the set.
    pub fn layout(&self) -> &Arc<SetLayout> {
        &self.layout
    }
}

impl Drop for DescriptorSet {
    fn drop(&mut self) {
        self.layout.free(self.raw, self.pool);
        Counters::sub(&self.layout.device.counters.sets, 1);
    }
}

fn kind_in(layout: &SetLayout, binding: u32) -> vk::DescriptorType {
    layout.bindings.iter().find(|b| b.binding == binding).map_or(vk::DescriptorType::SAMPLER, |b| b.kind)
}

fn check(layout: &SetLayout, binding: u32, element: u32, what: Bound<'_>) -> Result<(), Error> {
    use vk::DescriptorType as D;
    let Some(desc) = layout.bindings.iter().find(|b| b.binding == binding) else {
        return Err(Error::range("binding of a descriptor set", "one of the layout", binding));
    };
    if element >= desc.count {
        return Err(Error::range(
            "array element of a binding",
            format_args!("below {}", desc.count),
            element,
        ));
    }
    let fits = match what {
        Bound::Buffer(_) | Bound::BufferRange(..) => matches!(
            desc.kind,
            D::UNIFORM_BUFFER | D::STORAGE_BUFFER | D::UNIFORM_BUFFER_DYNAMIC | D::STORAGE_BUFFER_DYNAMIC
        ),
        Bound::Sampled(_) | Bound::SampledDepth(_) => desc.kind == D::SAMPLED_IMAGE,
        Bound::Storage(_) => desc.kind == D::STORAGE_IMAGE,
        Bound::Sampler(_) => desc.kind == D::SAMPLER,
    };
    if !fits {
        return Err(Error::range(
            "kind of a descriptor",
            format_args!("{:?} at binding {binding}", desc.kind),
            match what {
                Bound::Buffer(_) | Bound::BufferRange(..) => "a buffer",
                Bound::Sampled(_) | Bound::SampledDepth(_) => "a sampled image",
                Bound::Storage(_) => "a storage image",
                Bound::Sampler(_) => "a sampler",
            },
        ));
    }
    if let Bound::BufferRange(buffer, offset, size) = what
        && (size == 0 || offset.checked_add(size).is_none_or(|end| end > buffer.size()))
    {
        return Err(Error::range(
            "range of a bound buffer",
            format_args!("within {} bytes", buffer.size()),
            format_args!("{size} bytes at {offset}"),
        ));
    }
    Ok(())
}
