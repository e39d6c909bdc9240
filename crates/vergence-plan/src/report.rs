//! The plan for people and for other programs.

use serde::Serialize;
use vergence_scene::{Coverage, Law, Surface};

use crate::Plan;

/// A plan as it is printed; its JSON is an interface.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// What the GPU does every frame, in order.
    pub passes: Vec<Listed>,
    /// How surfaces are drawn: one pipeline each.
    pub pipelines: Vec<PipelineReport>,
    /// Whether texts are drawn.
    pub text: bool,
    /// Whether joints move vertices.
    pub skinning: bool,
    /// Whether something moves by itself.
    pub animation: bool,
    /// Images that are uploaded.
    pub images: usize,
    /// Lights that shine.
    pub lights: usize,
    /// OpenXR extensions that are asked for.
    pub extensions: Vec<Listed>,
    /// What the user can do.
    pub actions: Vec<Listed>,
    /// What is read every frame.
    pub streams: Vec<Listed>,
}

/// Something that is in the plan, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Listed {
    /// What logs and runtimes call it.
    pub name: String,
    /// What requires it.
    pub why: String,
}

/// How a surface is drawn.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PipelineReport {
    /// The law of reflection.
    pub law: &'static str,
    /// What is sampled or multiplied per pixel.
    pub inputs: Vec<&'static str>,
    /// `opaque`, `mask` or `blend`.
    pub coverage: &'static str,
    /// Whether the back is drawn.
    pub double_sided: bool,
}

impl PipelineReport {
    fn of(surface: &Surface) -> Self {
        let inputs = [
            (surface.base_color_texture, "base color texture"),
            (surface.metallic_roughness_texture, "metallic-roughness texture"),
            (surface.normal_texture, "normal map"),
            (surface.occlusion_texture, "occlusion texture"),
            (surface.emissive_texture, "emissive texture"),
            (surface.vertex_colors, "vertex colors"),
        ];
        Self {
            law: match surface.law {
                Law::Unlit => "unlit",
                Law::MetallicRoughness => "metallic-roughness",
                Law::BlinnPhong => "blinn-phong",
            },
            inputs: inputs.into_iter().filter_map(|(used, name)| used.then_some(name)).collect(),
            coverage: match surface.coverage {
                Coverage::Opaque => "opaque",
                Coverage::Mask => "mask",
                Coverage::Blend => "blend",
            },
            double_sided: surface.double_sided,
        }
    }
}

impl std::fmt::Display for PipelineReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, {}", self.law, self.coverage)?;
        for input in &self.inputs {
            write!(f, ", {input}")?;
        }
        if self.double_sided { f.write_str(", double-sided") } else { Ok(()) }
    }
}

impl Plan {
    /// The plan as it is printed.
    pub fn report(&self) -> Report {
        let listed = |name: &str, why: &str| Listed { name: name.to_owned(), why: why.to_owned() };
        Report {
            passes: self.passes.iter().map(|p| listed(p.name(), p.why())).collect(),
            pipelines: self.needs.surfaces.iter().map(PipelineReport::of).collect(),
            text: self.needs.text,
            skinning: self.needs.skinning,
            animation: self.needs.animation,
            images: self.needs.images.len(),
            lights: self.needs.lights,
            extensions: self
                .extensions
                .iter()
                .map(|e| listed(e.name, &format!("{}{}", e.why, if e.required { " (required)" } else { "" })))
                .collect(),
            actions: self
                .actions
                .actions
                .iter()
                .map(|a| listed(a.name, &format!("{} ({})", a.label, a.kind.name())))
                .collect(),
            streams: self.streams.iter().map(|s| listed(s.name(), s.why())).collect(),
        }
    }
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let list = |f: &mut std::fmt::Formatter<'_>, title: &str, items: &[Listed]| {
            writeln!(f, "{title}{}", if items.is_empty() { ": none" } else { ":" })?;
            items.iter().try_for_each(|item| writeln!(f, "  {:<32} {}", item.name, item.why))
        };
        list(f, "passes", &self.passes)?;
        let none = if self.pipelines.is_empty() { ": none" } else { ":" };
        writeln!(f, "surface pipelines{none}")?;
        for pipeline in &self.pipelines {
            writeln!(f, "  {pipeline}")?;
        }
        let yes_no = |yes: bool| if yes { "yes" } else { "no" };
        writeln!(
            f,
            "text: {}, skinning: {}, animation: {}, images: {}, lights: {}",
            yes_no(self.text),
            yes_no(self.skinning),
            yes_no(self.animation),
            self.images,
            self.lights
        )?;
        list(f, "OpenXR extensions", &self.extensions)?;
        list(f, "actions", &self.actions)?;
        list(f, "streams", &self.streams)
    }
}
