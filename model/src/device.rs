//! What answers G-rays: the processor, or a GPU, as it was asked for; and how that is told.
//!
//! Invariants: 1. a device that is asked for by name is used, or opening the model is an error; 2. what is chosen by
//! itself falls back to the processor, and says why.

use serde::Serialize;
#[cfg(feature = "gpu")]
use std::sync::{Arc, OnceLock};
#[cfg(feature = "gpu")]
use trex_gpu::{DeviceQuery, GpuDevice, GpuOptions, GpuStage, StepCounts, WhenTooLarge};
use trex_render::{CpuStage, GNeeds, GStage, PictureNeeds};
use trex_store::{Budget, Result};
#[cfg(not(feature = "gpu"))]
use trex_store::{Code, Error, NextStep};

/// The name of the processor, as a device.
const PROCESSOR: &str = "cpu";

/// Which device answers G-rays.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// The processor: the same command gives the same bytes on every machine.
    #[default]
    Cpu,
    /// A GPU where there is one, never one in software; else the processor.
    Auto,
    /// A GPU, in hardware if there is one, else in software.
    Gpu,
    /// The GPU whose name holds these words.
    Named(String),
}

/// Which device answers G-rays, and how much of its memory may be taken.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceOptions {
    /// The device.
    pub device: Device,
    /// Most bytes of video memory; `None`: 2 GiB, of a GPU in software a quarter of the process's limit.
    pub gpu_memory_limit_bytes: Option<u64>,
}

/// The device that answers G-rays, and what it has done.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DeviceReport {
    /// `cpu`, or the name of a GPU.
    pub name: String,
    /// Why it is this one.
    pub reason: String,
    /// Why the processor answers in its place, where it does.
    pub notice: Option<String>,
    /// Of a GPU.
    pub gpu: Option<GpuFigures>,
}

/// What a GPU is, and what it has done.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct GpuFigures {
    /// Its driver.
    pub driver: String,
    /// False for one in software.
    pub is_hardware: bool,
    /// Most bytes of its memory.
    pub memory_limit_bytes: u64,
    /// Bytes of its memory that are leased.
    pub memory_used_bytes: u64,
    /// Rays that it has answered.
    pub rays: u64,
    /// Rays that the processor has answered in its place.
    pub processor_rays: u64,
    /// Batches that it was given.
    pub batches: u64,
    /// Bytes that went to it.
    pub uploaded_bytes: u64,
    /// Bytes that came back.
    pub read_back_bytes: u64,
    /// Pages of units that went to it.
    pub unit_uploads: u64,
    /// Pages of units that gave way to others.
    pub unit_evictions: u64,
    /// Time of the kernel of shadow rays, ns; 0 of a device that does not tell.
    pub shadow_ns: u64,
    /// Time of the kernel of all other rays, ns.
    pub surface_ns: u64,
}

/// The device of a model, from which each session has its stage.
#[derive(Debug)]
pub struct StageSource {
    reason: String,
    #[cfg(feature = "gpu")]
    gpu: Option<(Arc<GpuDevice>, WhenTooLarge)>,
    /// Why a stage on the GPU could not be made.
    #[cfg(feature = "gpu")]
    refusal: OnceLock<String>,
}

#[cfg(feature = "gpu")]
impl StageSource {
    /// The device that is asked for.
    ///
    /// # Errors
    /// [`trex_store::Code::NoAdapter`] where it was asked for by name; [`trex_store::Code::MemoryLimit`] where the
    /// limit has no room for it.
    pub fn open(options: &DeviceOptions, budget: &Budget) -> Result<StageSource> {
        let gpu_options =
            GpuOptions { memory_limit_bytes: options.gpu_memory_limit_bytes, budget: budget.clone() };
        let (query, when_too_large) = match &options.device {
            Device::Cpu => {
                return Ok(StageSource::processor("it was asked for, or nothing else was".to_owned()));
            }
            Device::Auto => (DeviceQuery::Hardware, WhenTooLarge::UseProcessor),
            Device::Gpu => (DeviceQuery::Any, WhenTooLarge::Refuse),
            Device::Named(name) => (DeviceQuery::Name(name), WhenTooLarge::Refuse),
        };
        match GpuDevice::open(query, &gpu_options) {
            Ok(device) => {
                let reason = match &options.device {
                    Device::Auto => "the first GPU in hardware",
                    Device::Gpu if device.report().is_hardware => {
                        "a GPU was asked for; the first in hardware"
                    }
                    Device::Gpu => "a GPU was asked for, and there is none in hardware",
                    _ => "it was asked for by name",
                };
                let (gpu, reason) = (Some((Arc::new(device), when_too_large)), reason.to_owned());
                Ok(StageSource { reason, gpu, refusal: OnceLock::new() })
            }
            Err(error) if options.device == Device::Auto => {
                let reason = format!("no GPU in hardware: {}; {}", error.what(), error.numbers_text());
                Ok(StageSource::processor(reason))
            }
            Err(error) => Err(error),
        }
    }

    fn processor(reason: String) -> StageSource {
        StageSource { reason, gpu: None, refusal: OnceLock::new() }
    }

    /// A stage for a session.
    ///
    /// # Errors
    /// Those of [`GpuStage::new`], where the device was asked for by name.
    pub fn stage(&self) -> Result<Box<dyn GStage>> {
        self.stage_with(StepCounts::Off)
    }

    /// A stage that counts the steps of its walks, for who measures; [`StageSource::steps_and_walks`] tells them.
    ///
    /// # Errors
    /// Those of [`StageSource::stage`].
    pub fn counting_stage(&self) -> Result<Box<dyn GStage>> {
        self.stage_with(StepCounts::On)
    }

    /// Steps and walks of the stages that count them, and of all, so far.
    pub fn steps_and_walks(&self) -> [u64; 2] {
        self.gpu.as_ref().map_or([0; 2], |(device, _)| [device.counts().steps, device.counts().rays])
    }

    fn stage_with(&self, steps: StepCounts) -> Result<Box<dyn GStage>> {
        let Some((device, when_too_large)) = &self.gpu else { return Ok(Box::new(CpuStage::default())) };
        match GpuStage::counting(device.clone(), *when_too_large, steps) {
            Ok(stage) => Ok(Box::new(stage)),
            Err(error) if *when_too_large == WhenTooLarge::UseProcessor => {
                let _ = self.refusal.set(format!("{}: {}", error.what(), error.numbers_text()));
                Ok(Box::new(CpuStage::default()))
            }
            Err(error) => Err(error),
        }
    }

    /// What its stages ask of who calls them.
    pub fn needs(&self) -> GNeeds {
        self.gpu.as_ref().map_or(CpuStage::NEEDS, |(device, _)| GpuStage::needs_of(device))
    }

    /// Bytes of the process's memory that are leased for it.
    pub fn leased_bytes(&self) -> u64 {
        self.gpu.as_ref().map_or(0, |(device, _)| device.leased_bytes())
    }

    /// What it is, and what it has done.
    pub fn report(&self) -> DeviceReport {
        let name = self.gpu.as_ref().map_or(PROCESSOR, |(device, _)| &device.report().name).to_owned();
        let refusal = self.refusal.get().cloned();
        let notice = self.gpu.as_ref().and_then(|(device, _)| device.notice()).or(refusal);
        let gpu = self.gpu.as_ref().map(|(device, _)| {
            let (counts, report) = (device.counts(), device.report());
            GpuFigures {
                driver: report.driver.clone(),
                is_hardware: report.is_hardware,
                memory_limit_bytes: device.memory_limit_bytes(),
                memory_used_bytes: device.memory_used_bytes(),
                rays: counts.rays,
                processor_rays: counts.processor_rays,
                batches: counts.batches,
                uploaded_bytes: counts.uploaded_bytes,
                read_back_bytes: counts.read_back_bytes,
                unit_uploads: counts.unit_uploads,
                unit_evictions: counts.unit_evictions,
                shadow_ns: counts.shadow_ns,
                surface_ns: counts.surface_ns,
            }
        });
        DeviceReport { name, reason: self.reason.clone(), notice, gpu }
    }
}

#[cfg(not(feature = "gpu"))]
impl StageSource {
    /// The device that is asked for: without the feature there is the processor alone.
    ///
    /// # Errors
    /// [`Code::NoAdapter`] where another was asked for by name.
    pub fn open(options: &DeviceOptions, _budget: &Budget) -> Result<StageSource> {
        let place = match &options.device {
            Device::Cpu => {
                return Ok(StageSource { reason: "it was asked for, or nothing else was".to_owned() });
            }
            Device::Auto => return Ok(StageSource { reason: "this build knows no GPUs".to_owned() }),
            Device::Gpu => "the GPUs of this machine".to_owned(),
            Device::Named(name) => format!("the device {name:?}"),
        };
        Err(Error::new(Code::NoAdapter, "this build knows no GPUs")
            .at_place(place)
            .numbers("it was built without the feature for them")
            .next(NextStep::OtherDevice))
    }

    /// A stage for a session.
    ///
    /// # Errors
    /// None.
    pub fn stage(&self) -> Result<Box<dyn GStage>> {
        Ok(Box::new(CpuStage::default()))
    }

    /// A stage that counts the steps of its walks: the processor's does not.
    ///
    /// # Errors
    /// None.
    pub fn counting_stage(&self) -> Result<Box<dyn GStage>> {
        self.stage()
    }

    /// Steps and walks of stages that count them: none.
    pub fn steps_and_walks(&self) -> [u64; 2] {
        [0; 2]
    }

    /// What its stages ask of who calls them.
    pub fn needs(&self) -> GNeeds {
        CpuStage::NEEDS
    }

    /// Bytes of the process's memory that are leased for it: none.
    pub fn leased_bytes(&self) -> u64 {
        0
    }

    /// What it is.
    pub fn report(&self) -> DeviceReport {
        DeviceReport { name: PROCESSOR.to_owned(), reason: self.reason.clone(), notice: None, gpu: None }
    }
}

impl StageSource {
    /// What a picture needs whose G-rays this device answers.
    pub fn with_needs(&self, needs: &PictureNeeds) -> PictureNeeds {
        let copies_bytes = needs.copies_bytes + self.leased_bytes();
        PictureNeeds { g_needs: self.needs(), copies_bytes, ..*needs }
    }
}
