//! `Kernels`: the shaders, joined from their texts, and the pipelines made of them.
//!
//! Sizes are override constants of the texts, set when a pipeline is made ([`Form::constants`]): they stand in Rust
//! alone. Whether steps are counted is one of them, so that kernels which do not count have no trace of it; and whether
//! rays may go on into units, since most files have none: a walk without them has a third less to do on llvmpipe.
//!
//! Loops are not bounded by the compiler (that costs a shader much of its speed): the walk has a bound of its own,
//! and the others go over a few levels. Indices into buffers are checked, all the same.
//!
//! Invariant: both kernels see the same bindings, so that one bind group serves both.

#![allow(unsafe_code)]

use crate::device::GpuDevice;
use trex_store::layout::{FRAME_BYTES, PAGES};
use trex_store::octree::OCTAHEDRAL_BITS;
use trex_store::{Code, Error, NextStep, Result};

/// The texts that kernels share, in the order in which they are joined.
const SHARED: [&str; 3] = [
    include_str!("../shaders/octree.wgsl"),
    include_str!("../shaders/walk.wgsl"),
    include_str!("../shaders/surface.wgsl"),
];

/// Invocations of a workgroup.
pub(crate) const WORKGROUP_RAYS: u32 = 64;

/// A kernel: the name of its entry point, and the text of that.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kernel {
    name: &'static str,
    entry: &'static str,
}

/// Whether kernels count the steps of their walks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StepCounts {
    /// They do not.
    #[default]
    Off,
    /// They do, for who measures: an atomic addition a ray.
    On,
}

/// What a pipeline is made for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Form {
    pub(crate) steps: StepCounts,
    /// Rays may go on into units; if not, `Params::finer` is 0.
    pub(crate) has_units: bool,
}

impl Form {
    /// The override constants of all texts, by name.
    pub(crate) fn constants(self) -> [(&'static str, f64); 6] {
        [
            ("WORKGROUP_RAYS", f64::from(WORKGROUP_RAYS)),
            ("FRAME_WORDS", (FRAME_BYTES / 4) as f64),
            ("PAGE_BITS", f64::from(PAGES.ilog2())),
            ("OCTAHEDRAL_BITS", f64::from(OCTAHEDRAL_BITS)),
            ("COUNTS_STEPS", f64::from(u8::from(self.steps == StepCounts::On))),
            ("HAS_UNITS", f64::from(u8::from(self.has_units))),
        ]
    }
}

/// All kernels.
pub(crate) const KERNELS: [Kernel; 2] = [
    Kernel { name: "shadow_rays", entry: include_str!("../shaders/shadow_rays.wgsl") },
    Kernel { name: "surface_rays", entry: include_str!("../shaders/surface_rays.wgsl") },
];

impl Kernel {
    /// The whole text.
    pub(crate) fn text(&self) -> String {
        let mut text = SHARED.concat();
        text.push_str(self.entry);
        text
    }
}

/// The bindings, by number, and whether a kernel only reads them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(crate) enum Binding {
    Params,
    Rays,
    Answers,
    Nodes,
    Bitmaps,
    Payload,
    PageSlots,
    Frames,
    SlotsUsed,
}

impl Binding {
    const ALL: [Binding; 9] = [
        Binding::Params,
        Binding::Rays,
        Binding::Answers,
        Binding::Nodes,
        Binding::Bitmaps,
        Binding::Payload,
        Binding::PageSlots,
        Binding::Frames,
        Binding::SlotsUsed,
    ];

    fn ty(self) -> wgpu::BufferBindingType {
        match self {
            Binding::Params => wgpu::BufferBindingType::Uniform,
            Binding::Answers | Binding::SlotsUsed => wgpu::BufferBindingType::Storage { read_only: false },
            _ => wgpu::BufferBindingType::Storage { read_only: true },
        }
    }

    fn layout(self) -> wgpu::BindGroupLayoutEntry {
        let ty =
            wgpu::BindingType::Buffer { ty: self.ty(), has_dynamic_offset: false, min_binding_size: None };
        wgpu::BindGroupLayoutEntry {
            binding: self as u32,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty,
            count: None,
        }
    }
}

/// The pipelines of one form.
#[derive(Debug)]
pub(crate) struct Pipelines {
    pub(crate) shadow_rays: wgpu::ComputePipeline,
    pub(crate) surface_rays: wgpu::ComputePipeline,
}

/// All pipelines.
#[derive(Debug)]
pub(crate) struct Kernels {
    pub(crate) plain: Pipelines,
    pub(crate) in_units: Pipelines,
    layout: wgpu::BindGroupLayout,
}

impl Kernels {
    /// Compiles all kernels.
    ///
    /// # Errors
    /// [`Code::NoAdapter`] when the driver refuses one.
    pub(crate) fn new(device: &GpuDevice, steps: StepCounts) -> Result<Kernels> {
        let gpu = &device.device;
        let scope = gpu.push_error_scope(wgpu::ErrorFilter::Validation);
        let entries = Binding::ALL.map(Binding::layout);
        let layout = gpu.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("octree"),
            entries: &entries,
        });
        let pipeline_layout = gpu.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("octree"),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let [plain, in_units] = [false, true].map(|has_units| {
            let form = Form { steps, has_units };
            let [shadow_rays, surface_rays] =
                KERNELS.map(|kernel| Kernels::compile(gpu, &pipeline_layout, (kernel, form)));
            Pipelines { shadow_rays, surface_rays }
        });
        match pollster::block_on(scope.pop()) {
            Some(error) => Err(Error::new(Code::NoAdapter, "the driver refuses a shader")
                .at_place(format!("the device {:?}", device.report().name))
                .numbers(error.to_string())
                .next(NextStep::OtherDevice)),
            None => Ok(Kernels { plain, in_units, layout }),
        }
    }

    fn compile(
        gpu: &wgpu::Device,
        layout: &wgpu::PipelineLayout,
        (kernel, form): (Kernel, Form),
    ) -> wgpu::ComputePipeline {
        let source = wgpu::ShaderSource::Wgsl(kernel.text().into());
        let descriptor = wgpu::ShaderModuleDescriptor { label: Some(kernel.name), source };
        let checks =
            wgpu::ShaderRuntimeChecks { force_loop_bounding: false, ..wgpu::ShaderRuntimeChecks::checked() };
        // SAFETY: all checks stay on but the bounding of loops, and every loop of the texts ends: the walk after
        // `steps_max`, its way down after a level each, the others after a count that is a constant or a level.
        let module = unsafe { gpu.create_shader_module_trusted(descriptor, checks) };
        gpu.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(kernel.name),
            layout: Some(layout),
            module: &module,
            entry_point: Some(kernel.name),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &form.constants(),
                ..wgpu::PipelineCompilationOptions::default()
            },
            cache: None,
        })
    }

    /// A bind group of these buffers.
    pub(crate) fn bind(&self, gpu: &wgpu::Device, buffers: [(Binding, &wgpu::Buffer); 9]) -> wgpu::BindGroup {
        let entries = buffers.map(|(at, buffer)| wgpu::BindGroupEntry {
            binding: at as u32,
            resource: buffer.as_entire_binding(),
        });
        let layout = &self.layout;
        gpu.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use naga::valid::{Capabilities, ValidationFlags, Validator};

    /// Without any adapter: what drivers are given is sound WGSL, has the entry point that is asked for, and needs the
    /// override constants that are set, no others; with these it is sound, and becomes SPIR-V.
    #[test]
    fn shaders_are_valid() {
        let forms = [(StepCounts::Off, false), (StepCounts::Off, true), (StepCounts::On, true)];
        let forms = forms.map(|(steps, has_units)| Form { steps, has_units });
        for (kernel, form) in KERNELS.into_iter().flat_map(|kernel| forms.map(|form| (kernel, form))) {
            let text = kernel.text();
            let module = naga::front::wgsl::parse_str(&text)
                .unwrap_or_else(|error| panic!("{}: {}", kernel.name, error.emit_to_string(&text)));
            let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
                .validate(&module)
                .unwrap_or_else(|error| panic!("{}: {}", kernel.name, error.emit_to_string(&text)));
            let mut needed: Vec<_> =
                module.overrides.iter().map(|(_, constant)| constant.name.as_deref().unwrap()).collect();
            let mut set = form.constants().map(|(name, _)| name).to_vec();
            needed.sort_unstable();
            set.sort_unstable();
            assert_eq!(needed, set, "{}", kernel.name);
            let constants = form.constants().into_iter().map(|(name, value)| (name.to_owned(), value));
            let stage = naga::ShaderStage::Compute;
            let (module, info) = naga::back::pipeline_constants::process_overrides(
                &module,
                &info,
                Some((stage, kernel.name)),
                &constants.collect(),
            )
            .unwrap();
            let [entry] = module.entry_points.as_slice() else { panic!("{}: one entry point", kernel.name) };
            assert_eq!((entry.name.as_str(), entry.workgroup_size), (kernel.name, [WORKGROUP_RAYS, 1, 1]));
            let words =
                naga::back::spv::write_vec(&module, &info, &naga::back::spv::Options::default(), None);
            assert!(words.unwrap().len() > 1000, "{}", kernel.name);
        }
    }

    /// What stands in both: the numbers of bindings, and what kernels do with them.
    #[test]
    fn bindings_are_those_of_the_shaders() {
        let module = naga::front::wgsl::parse_str(&KERNELS[1].text()).unwrap();
        let mut found: Vec<_> = module
            .global_variables
            .iter()
            .filter_map(|(_, variable)| Some((variable.binding?.binding, variable.space)))
            .collect();
        found.sort_by_key(|(binding, _)| *binding);
        let expected = Binding::ALL.map(|binding| {
            let space = match binding.ty() {
                wgpu::BufferBindingType::Uniform => naga::AddressSpace::Uniform,
                wgpu::BufferBindingType::Storage { read_only } => {
                    let write =
                        if read_only { naga::StorageAccess::empty() } else { naga::StorageAccess::STORE };
                    naga::AddressSpace::Storage { access: naga::StorageAccess::LOAD | write }
                }
            };
            (binding as u32, space)
        });
        assert_eq!(found, expected);
    }
}
