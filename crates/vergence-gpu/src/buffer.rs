//! Buffers: on the device, or visible to the host.

use std::ptr::NonNull;
use std::sync::{Arc, Mutex, PoisonError};

use ash::vk;
use bytemuck::Pod;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use crate::census::Counters;
use crate::device::Device;
use crate::error::{At, Error};

/// Where a buffer lives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// On the device: fastest for the device, filled by copies ([`Upload`](crate::Upload)).
    Device,
    /// Visible to the host, written by it every frame and read by the device.
    Upload,
    /// Visible to the host and cached, written by the device and read by the host.
    ReadBack,
}

/// The mapped bytes of a host-visible buffer.
struct Mapped(NonNull<u8>);

// SAFETY: the pointer is to memory that the allocation owns, and is only dereferenced under the buffer's lock.
unsafe impl Send for Mapped {}

/// A buffer.
pub struct Buffer {
    pub(crate) raw: vk::Buffer,
    size: u64,
    usage: vk::BufferUsageFlags,
    memory: Memory,
    mapped: Option<Mutex<Mapped>>,
    allocation: Option<Allocation>,
    bytes: u64,
    device: Arc<Device>,
}

impl Buffer {
    /// Makes a buffer of `size` bytes (at least 1); `TRANSFER_SRC` and `TRANSFER_DST` are added to `usage` for device memory.
    ///
    /// # Errors
    ///
    /// No memory, or `size` 0.
    pub fn new(
        device: &Arc<Device>,
        name: &str,
        size: u64,
        usage: vk::BufferUsageFlags,
        memory: Memory,
    ) -> Result<Arc<Self>, Error> {
        if size == 0 {
            return Err(Error::range("size of a buffer", "at least 1 byte", 0));
        }
        let usage = match memory {
            Memory::Device => usage | vk::BufferUsageFlags::TRANSFER_DST | vk::BufferUsageFlags::TRANSFER_SRC,
            Memory::Upload => usage | vk::BufferUsageFlags::TRANSFER_SRC,
            Memory::ReadBack => usage | vk::BufferUsageFlags::TRANSFER_DST,
        };
        let info =
            vk::BufferCreateInfo::default().size(size).usage(usage).sharing_mode(vk::SharingMode::EXCLUSIVE);
        // SAFETY: the create info is complete.
        let raw = unsafe { device.raw.create_buffer(&info, None) }.at("vkCreateBuffer")?;
        // SAFETY: the buffer was just made.
        let requirements = unsafe { device.raw.get_buffer_memory_requirements(raw) };
        let location = match memory {
            Memory::Device => MemoryLocation::GpuOnly,
            Memory::Upload => MemoryLocation::CpuToGpu,
            Memory::ReadBack => MemoryLocation::GpuToCpu,
        };
        let allocated = lock_memory(device).allocate(&AllocationCreateDesc {
            name,
            requirements,
            location,
            linear: true,
            allocation_scheme: AllocationScheme::GpuAllocatorManaged,
        });
        let allocation = match allocated {
            Ok(allocation) => allocation,
            Err(error) => {
                // SAFETY: made above, never used.
                unsafe { device.raw.destroy_buffer(raw, None) };
                return Err(Error::Memory { name: name.into(), bytes: size, detail: error.to_string() });
            }
        };
        let bytes = allocation.size();
        Counters::add(&device.counters.buffers, 1);
        Counters::add(&device.counters.buffer_bytes, bytes);
        let mapped = match memory {
            Memory::Device => None,
            _ => allocation.mapped_ptr().map(|p| Mutex::new(Mapped(p.cast()))),
        };
        // From here on the destructor undoes everything.
        let mut buffer =
            Self { raw, size, usage, memory, mapped, allocation: None, bytes, device: Arc::clone(device) };
        // SAFETY: memory and offset come from the allocator for exactly these requirements, and are bound once.
        let bound = unsafe { device.raw.bind_buffer_memory(raw, allocation.memory(), allocation.offset()) };
        buffer.allocation = Some(allocation);
        bound.at("vkBindBufferMemory")?;
        device.name(raw, name);
        Ok(Arc::new(buffer))
    }

    /// Size in bytes, as asked for.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// What it may be used for.
    pub fn usage(&self) -> vk::BufferUsageFlags {
        self.usage
    }

    /// The device that it lives on.
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }

    /// Where it lives.
    pub fn memory(&self) -> Memory {
        self.memory
    }

    /// Copies `data` to `offset` (bytes). The device must not be reading that range: the caller waits for the frame that used it.
    ///
    /// # Errors
    ///
    /// A range outside of the buffer, or a buffer that the host cannot see.
    pub fn write<T: Pod>(&self, offset: u64, data: &[T]) -> Result<(), Error> {
        let data: &[u8] = bytemuck::cast_slice(data);
        self.with_bytes(offset, data.len() as u64, |bytes| bytes.copy_from_slice(data))
    }

    /// Copies `data.len()` values from `offset` (bytes). The device must have finished writing them (and a barrier to
    /// [`Use::HostRead`](crate::Use::HostRead) must have been recorded).
    ///
    /// # Errors
    ///
    /// As for [`Buffer::write`].
    pub fn read<T: Pod>(&self, offset: u64, data: &mut [T]) -> Result<(), Error> {
        let data: &mut [u8] = bytemuck::cast_slice_mut(data);
        self.with_bytes(offset, data.len() as u64, |bytes| data.copy_from_slice(bytes))
    }

    /// Gives `len` mapped bytes at `offset` to `f`; slow to read unless the memory is [`Memory::ReadBack`]. The bytes may have any value.
    ///
    /// # Errors
    ///
    /// As for [`Buffer::write`].
    pub fn with_bytes<R>(&self, offset: u64, len: u64, f: impl FnOnce(&mut [u8]) -> R) -> Result<R, Error> {
        let Some(mapped) = &self.mapped else {
            return Err(Error::range(
                "memory of a buffer",
                "visible to the host",
                format_args!("{:?}", self.memory),
            ));
        };
        match offset.checked_add(len) {
            Some(end) if end <= self.size => {}
            _ => {
                return Err(Error::range(
                    "range in a buffer",
                    format_args!("within {} bytes", self.size),
                    format_args!("{len} bytes at {offset}"),
                ));
            }
        }
        let mapped = mapped.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the allocation maps at least `size` bytes, `offset + len` lies within; the lock makes the slice unique on
        // the host. The memory is coherent (the allocator asks for it), so that nothing needs flushing.
        let bytes =
            unsafe { std::slice::from_raw_parts_mut(mapped.0.as_ptr().add(offset as usize), len as usize) };
        Ok(f(bytes))
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        // SAFETY: command buffers and descriptor sets that use the buffer hold an Arc of it until they are complete.
        unsafe { self.device.raw.destroy_buffer(self.raw, None) };
        if let Some(allocation) = self.allocation.take() {
            let _ = lock_memory(&self.device).free(allocation);
        }
        Counters::sub(&self.device.counters.buffers, 1);
        Counters::sub(&self.device.counters.buffer_bytes, self.bytes);
    }
}

/// The allocator, for the moment of one call.
pub(crate) fn lock_memory(
    device: &Device,
) -> std::sync::MutexGuard<'_, std::mem::ManuallyDrop<gpu_allocator::vulkan::Allocator>> {
    device.memory.lock().unwrap_or_else(PoisonError::into_inner)
}
