//! A frame, from the pose of the scene to a submission.

use std::sync::Arc;

use vergence_geom::View;
use vergence_gpu::{Device, SetLayout, Upload};
use vergence_scene::Needs;
use vergence_scene::model::{LightKind, Scene};
use vergence_time::Span;

use crate::between::Between;
use crate::cull::{Item, Visible, middle_of};
use crate::draws::{Bindings, Draws, Geometry, is_mirrored, upload_geometry};
use crate::hidden::Hidden;
use crate::labels::Labels;
use crate::meshes::{Meshes, at};
use crate::pipelines::KindPipelines;
use crate::pose::Pose;
use crate::skinning::Skinning;
use crate::slots::{Slot, State, Windows, frame_set_layout, upload_materials};
use crate::target::{Attachments, Target};
use crate::textures::{self, TextureSet};
use crate::views::{Axes, Eyes, PLACE_ROWS, PackedFrame, pack};
use crate::{Error, MAX_LIGHTS, MAX_VIEWS, Quality, lights};

/// GPU time of a pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassMs {
    /// "skinning" or "surfaces".
    pub name: &'static str,
    /// Milliseconds.
    pub ms: f64,
}

/// What a frame drew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Triangles of the whole scene.
    pub triangles: u64,
    /// Triangles of parts that were not culled.
    pub triangles_drawn: u64,
    /// Parts and labels that were not culled.
    pub draws: u32,
}

/// Draws one scene to one kind of target.
pub struct Renderer {
    device: Arc<Device>,
    scene: Arc<Scene>,
    quality: Quality,
    target: Target,
    meshes: Meshes,
    pose: Pose,
    geometry: Option<Geometry>,
    kinds: Vec<KindPipelines>,
    textures: Vec<TextureSet>,
    skinning: Option<Skinning>,
    labels: Option<Labels>,
    hidden: Option<Hidden>,
    label_balls: Vec<(nalgebra::Point3<f64>, f64)>,
    frame_sets: Arc<SetLayout>,
    between: Between,
    visible: Visible,
    slots: Vec<Slot>,
    lights: Vec<usize>,
    light_counts: vergence_shaders::Lights,
    windows: Windows,
    statistics: Statistics,
    // Kept from frame to frame so that latching allocates nothing.
    axes: Vec<Option<Axes>>,
    rows: Vec<[f32; 4]>,
}

impl Renderer {
    /// Makes what `needs` (of this `scene`) says, and nothing else, for `frames_in_flight` frames.
    ///
    /// # Errors
    /// A quality that the device does not have, more lights than [`MAX_LIGHTS`], more views than [`MAX_VIEWS`], no
    /// memory, or a scene whose indices, or numbers of joints or weights, are wrong.
    pub fn new(
        device: &Arc<Device>,
        scene: &Arc<Scene>,
        needs: &Needs,
        quality: &Quality,
        target: &Target,
        frames_in_flight: usize,
    ) -> Result<Self, Error> {
        quality.check(device.limits())?;
        if !(1..=MAX_VIEWS).contains(&target.views) {
            return Err(Error::range("views", format!("1 to {MAX_VIEWS}"), target.views));
        }
        if needs.lights > MAX_LIGHTS as usize {
            return Err(Error::range("lights in the scene", format!("at most {MAX_LIGHTS}"), needs.lights));
        }
        if frames_in_flight == 0 {
            return Err(Error::range("frames in flight", "at least 1", 0));
        }
        let meshes = Meshes::of(scene, quality.normal_maps)?;
        let (lights, light_counts) = order_lights(scene)?;
        let mut pose = Pose::new(scene, &meshes);
        pose.update(scene, &meshes, Span::ZERO);

        let mut upload = Upload::new(device)?;
        let frame_sets = frame_set_layout(device)?;
        let geometry = upload_geometry(&mut upload, &meshes)?;
        let anisotropy = quality.anisotropy_on(device.limits());
        let textures = textures::upload(device, &mut upload, scene, &meshes.texture_sets, anisotropy)?;
        let skinning = Skinning::new(device, &mut upload, &meshes, frames_in_flight)?;
        let labels = if needs.text {
            Labels::new(device, &mut upload, scene, &frame_sets, target, quality.msaa)?
        } else {
            None
        };
        let windows =
            Windows::new(device, target, meshes.drawables.len() + labels.as_ref().map_or(0, Labels::len));
        let materials = upload_materials(&mut upload, &meshes, &windows)?;
        let rows = windows.rows();
        // Mesa 25's software device crashes on timestamps around a pass that resolves several layers' samples.
        let timestamps = quality.timestamps && !(device.limits().software && quality.msaa > 1);
        let slots = (0..frames_in_flight)
            .map(|_| Slot::new(device, &frame_sets, &windows, materials.as_ref(), timestamps))
            .collect::<Result<_, _>>()?;
        let mut renderer = Self {
            device: Arc::clone(device),
            scene: Arc::clone(scene),
            quality: quality.clone(),
            target: *target,
            pose,
            geometry,
            kinds: Vec::new(),
            textures,
            skinning,
            labels,
            hidden: None,
            label_balls: Vec::new(),
            frame_sets,
            between: Between::new(device, target, quality.msaa)?,
            visible: Visible::default(),
            slots,
            lights,
            light_counts,
            windows,
            statistics: Statistics { triangles: meshes.triangles, ..Statistics::default() },
            axes: Vec::new(),
            rows: Vec::with_capacity(rows),
            meshes,
        };
        renderer.make_pipelines()?;
        Ok(renderer)
    }

    /// The pipelines that the scene at rest needs.
    fn make_pipelines(&mut self) -> Result<(), Error> {
        let anisotropic = self.quality.anisotropy_on(self.device.limits()) > 1.0;
        for (index, kind) in self.meshes.kinds.iter().enumerate() {
            let mut user = self.meshes.drawables.iter().filter(|drawable| drawable.kind == index);
            let Some(textures) = user.next().map(|d| &self.textures[d.texture_set].layout) else { continue };
            self.kinds.push(KindPipelines::new(
                &self.device,
                *kind,
                &self.frame_sets,
                textures,
                anisotropic,
            )?);
        }
        let lights = self.light_counts;
        for drawable in &self.meshes.drawables {
            let mirrored = is_mirrored(&self.pose, drawable.node, drawable.skin);
            let kind = &mut self.kinds[drawable.kind];
            kind.get(&self.device, &self.target, self.quality.msaa, lights, mirrored)?;
        }
        Ok(())
    }

    /// What is drawn to.
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// The quality that it was made with.
    pub fn quality(&self) -> &Quality {
        &self.quality
    }

    /// Sets what the lens hides of each view (OpenXR's hidden triangle mesh): corners in the plane z = −1 of the
    /// eye, three indices per triangle. Empty lists take it away again.
    ///
    /// # Errors
    /// An index that is not below the number of corners, or no memory.
    pub fn visibility_mask(&mut self, areas: &[(Vec<[f32; 2]>, Vec<u32>)]) -> Result<(), Error> {
        let mut upload = Upload::new(&self.device)?;
        self.hidden =
            Hidden::new(&self.device, &mut upload, areas, &self.frame_sets, &self.target, self.quality.msaa)?;
        Ok(())
    }

    /// Places a node relative to its parent from the next frame on, whatever animates it. A node that is not there is
    /// nothing to place. Each is looked for among all that were placed so far: meant for a few.
    pub fn place(&mut self, node: usize, parent_from_node: &vergence_geom::Affine) {
        self.pose.place(node, parent_from_node);
    }

    /// Whether the mesh or label of a node is drawn, from the next frame on; at first, all are.
    pub fn show(&mut self, node: usize, shown: bool) {
        if let Some(hidden) = self.pose.hidden.get_mut(node) {
            *hidden = !shown;
        }
    }

    /// Begins a frame in `slot` (which waits for the frame that used it before): moves the scene to
    /// `animation_time`, finds what `cull_views` may see, and records the draws to `attachments`. A frame that was begun
    /// in `slot` and not submitted is dropped.
    ///
    /// # Errors
    /// A slot or a number of views that the renderer was not made with, or a lost device.
    pub fn begin(
        &mut self,
        slot: usize,
        animation_time: Span,
        cull_views: &[View],
        attachments: &Attachments<'_>,
    ) -> Result<(), Error> {
        self.check_views(cull_views)?;
        self.slot(slot)?;
        // What was begun and never submitted is dropped, and a frame that fails below cannot be submitted.
        self.slots[slot].state = State::Free;
        // Nothing of a frame in flight is written over: the device is done with this slot.
        self.slots[slot].commands.wait()?;
        self.pose.update(&self.scene, &self.meshes, animation_time);
        if let Some(labels) = &self.labels {
            labels.find_balls(&self.pose.world, &self.pose.hidden, &mut self.label_balls);
        }
        self.visible.find(&self.meshes, &self.pose, &self.label_balls, cull_views, &self.quality);
        if let Some(skinning) = &self.skinning {
            skinning.write(slot, &self.pose.joint_rows)?;
        }
        self.record(slot, attachments)?;
        self.slots[slot].state = State::Begun;
        Ok(())
    }

    fn record(&mut self, slot_index: usize, attachments: &Attachments<'_>) -> Result<(), Error> {
        let lights = self.light_counts;
        // A node that animation has mirrored may need a pipeline that nobody needed so far.
        for (_, item) in self.visible.covering.iter().chain(&self.visible.blended) {
            if let Item::Part(index) = item {
                let drawable = &self.meshes.drawables[*index as usize];
                let mirrored = is_mirrored(&self.pose, drawable.node, drawable.skin);
                let kind = &mut self.kinds[drawable.kind];
                kind.get(&self.device, &self.target, self.quality.msaa, lights, mirrored)?;
            }
        }
        self.between.complete(&self.device, &self.target, attachments)?;
        let passes = self.windows.passes as u32;
        let slot = &mut self.slots[slot_index];
        slot.items.clear();
        let mut encoder = slot.commands.record()?;
        if let Some(skinning) = &self.skinning {
            encoder.begin_pass("skinning");
            skinning.record(&mut encoder, slot_index);
            encoder.end_pass();
        }
        encoder.begin_pass("surfaces");
        slot.items.extend(self.visible.covering.iter().chain(&self.visible.blended).map(|(_, item)| *item));
        let mut triangles = 0;
        self.between.prepare(&mut encoder, attachments);
        for pass in 0..passes {
            let layer = (passes > 1).then_some(pass);
            let background = Some(self.scene.background);
            self.between.begin(&mut encoder, attachments, &self.target, layer, background)?;
            if let Some(set) = &slot.set {
                if let Some(hidden) = &self.hidden {
                    hidden.draw(&mut encoder, set, pass * self.windows.frame_stride, pass);
                }
                let mut draws = Draws {
                    meshes: &self.meshes,
                    pose: &self.pose,
                    geometry: self.geometry.as_ref(),
                    skinned: self.skinning.as_ref().map(|skinning| &skinning.result),
                    textures: &self.textures,
                    kinds: &mut self.kinds,
                    device: &self.device,
                    target: &self.target,
                    samples: self.quality.msaa,
                    lights,
                    set,
                    windows: self.windows,
                    pass,
                    bound: Bindings::default(),
                    triangles: 0,
                };
                for (number, item) in slot.items.iter().enumerate() {
                    let place = self.windows.place(pass as usize, number);
                    match item {
                        Item::Part(index) => draws.part(&mut encoder, *index as usize, place)?,
                        Item::Label(index) => {
                            if let Some(labels) = &self.labels {
                                let windows = [pass * self.windows.frame_stride, place, 0];
                                labels.draw(&mut encoder, set, *index as usize, windows);
                                draws.bound = Bindings::default();
                            }
                        }
                    }
                }
                triangles = draws.triangles;
            }
            encoder.end_rendering();
        }
        if passes > 1 && self.between.color.is_some() {
            self.between.before_resolve(&mut encoder, attachments);
            self.between.begin(&mut encoder, attachments, &self.target, None, None)?;
            encoder.end_rendering();
        }
        self.statistics.triangles_drawn = triangles;
        self.statistics.draws = slot.items.len() as u32;
        self.between.finish(&mut encoder, attachments);
        encoder.end_pass();
        Ok(encoder.finish()?)
    }

    /// Writes what depends on where the eyes are: the frame is drawn from `views`, whatever it was culled for. May be called
    /// again until the frame is submitted.
    ///
    /// # Errors
    /// Another number of views than the renderer was made with, or a frame that was not begun.
    pub fn latch(&mut self, slot: usize, views: &[View]) -> Result<(), Error> {
        self.check_views(views)?;
        if self.slot(slot)?.state == State::Free {
            return Err(Error::Order { expected: "begin", found: "latch" });
        }
        let viewer = middle_of(views);
        self.rows.clear();
        self.rows.resize(self.windows.rows(), [0.0; 4]);
        let per_pass = views.len() / self.windows.passes;
        for (pass, views) in views.chunks_exact(per_pass).enumerate() {
            let eyes = Eyes::new(views);
            self.write_frame(slot, pass, views, &eyes)?;
            self.write_places(slot, pass, &eyes, &viewer);
        }
        let slot = &mut self.slots[slot];
        if let Some(transforms) = slot.transforms.as_ref().filter(|_| !slot.items.is_empty()) {
            // From the first window that is used to the last.
            let used = self.windows.place_row(self.windows.passes - 1, slot.items.len());
            transforms.write(0, &self.rows[..used])?;
        }
        slot.state = State::Latched;
        Ok(())
    }

    fn write_places(&mut self, slot: usize, pass: usize, eyes: &Eyes, viewer: &nalgebra::Point3<f64>) {
        self.axes.clear();
        self.axes.resize(self.pose.world.world_from_node.len(), None);
        let upright = eyes.axes(&nalgebra::Matrix3::identity());
        for (number, item) in self.slots[slot].items.iter().enumerate() {
            let rows = &mut self.rows[self.windows.place_row(pass, number)..][..PLACE_ROWS];
            match *item {
                Item::Part(index) => {
                    let drawable = &self.meshes.drawables[index as usize];
                    if let Some(skin) = drawable.skin {
                        eyes.write_rows(&upright, &self.pose.anchors[skin], rows);
                        continue;
                    }
                    let world_from_node = &self.pose.world.world_from_node[drawable.node];
                    let axes =
                        self.axes[drawable.node].get_or_insert_with(|| eyes.axes(&world_from_node.linear));
                    eyes.write_rows(axes, &world_from_node.transform_point(&drawable.centre), rows);
                }
                Item::Label(index) => {
                    if let Some(labels) = &self.labels {
                        let (linear, place) = labels.stand(index as usize, &self.pose.world, viewer);
                        eyes.write_rows(&eyes.axes(&linear), &place, rows);
                    }
                }
            }
        }
    }

    fn write_frame(&mut self, slot: usize, pass: usize, views: &[View], eyes: &Eyes) -> Result<(), Error> {
        let mut frame: PackedFrame = bytemuck::Zeroable::zeroed();
        for (packed, view) in frame.views.iter_mut().zip(views) {
            *packed = pack(view, &eyes.head_from_world, self.target.size, self.quality.near_m);
        }
        let [r, g, b] = self.scene.ambient;
        frame.ambient = [r, g, b, 0.0];
        for (packed, &node) in frame.lights.iter_mut().zip(&self.lights) {
            if let Some(light) = self.scene.nodes[node].light {
                let world_from_node = &self.pose.world.world_from_node[node];
                *packed = lights::pack(&self.scene.lights[light], world_from_node, &eyes.head_from_world);
            }
        }
        // Only as much as is used: the rest of the lights stays as it is.
        let used = size_of::<PackedFrame>() - size_of_val(&frame.lights[self.lights.len()..]);
        let offset = pass as u64 * u64::from(self.windows.frame_stride);
        Ok(self.slots[slot].frame.write(offset, &bytemuck::bytes_of(&frame)[..used])?)
    }

    /// Hands the frame to the device; gives the number of the submission, for [`Device::wait`].
    ///
    /// # Errors
    /// A frame that was not latched, or a lost device.
    pub fn submit(&mut self, slot: usize) -> Result<u64, Error> {
        if self.slot(slot)?.state != State::Latched {
            return Err(Error::Order { expected: "latch", found: "submit" });
        }
        let device = Arc::clone(&self.device);
        let slot = &mut self.slots[slot];
        let submission = device.submit(&mut slot.commands, &[], &[])?;
        slot.state = State::Free;
        Ok(submission)
    }

    /// GPU time per pass of the last frame of `slot`, for which it waits; empty where timestamps are off or the
    /// device has none.
    ///
    /// # Errors
    /// A slot that does not exist, or a lost device.
    pub fn timings(&mut self, slot: usize) -> Result<Vec<PassMs>, Error> {
        self.slot(slot)?;
        let times = self.slots[slot].commands.pass_times()?;
        Ok(times.iter().map(|time| PassMs { name: time.name, ms: time.ns * 1e-6 }).collect())
    }

    /// What the last frame drew.
    pub fn statistics(&self) -> Statistics {
        self.statistics
    }

    fn slot(&self, slot: usize) -> Result<&Slot, Error> {
        let frames = self.slots.len();
        self.slots.get(slot).ok_or_else(|| Error::range("frame slot", format!("below {frames}"), slot))
    }

    fn check_views(&self, views: &[View]) -> Result<(), Error> {
        if views.len() != self.target.views as usize {
            return Err(Error::range("views", self.target.views, views.len()));
        }
        for view in views {
            view.fov.checked().map_err(|error| Error::range("view", "one that can be drawn", error))?;
        }
        Ok(())
    }
}

/// The nodes with lights, those at infinity first, as the shader wants them.
fn order_lights(scene: &Scene) -> Result<(Vec<usize>, vergence_shaders::Lights), Error> {
    let (mut infinite, mut placed) = (Vec::new(), Vec::new());
    for (index, node) in scene.nodes.iter().enumerate() {
        let Some(light) = node.light else { continue };
        match at("lights", &scene.lights, light)?.kind {
            LightKind::Directional => infinite.push(index),
            LightKind::Point { .. } | LightKind::Spot { .. } => placed.push(index),
        }
    }
    let counts = vergence_shaders::Lights { infinite: infinite.len() as u32, placed: placed.len() as u32 };
    infinite.append(&mut placed);
    Ok((infinite, counts))
}
