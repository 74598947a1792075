//! `Door`: where pages of a browser come to `trex view`, and how its user learns of it.
//!
//! Invariants: 1. the address is told once, however often the model is shown; 2. it stays the same until the end.

use crate::args::ViewArgs;
use crate::context::Context;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::process::{Command, Stdio};
use trex_render::FrameOptions;
use trex_store::{Code, Error, Result};
use trex_view::{Embedders, SILENCE_MAX, ServeOptions, Token};

/// See the module's description.
pub struct Door<'a> {
    args: &'a ViewArgs,
    /// Where it listens.
    pub listener: TcpListener,
    /// That place.
    pub address: SocketAddr,
    token: Token,
    is_told: bool,
}

impl<'a> Door<'a> {
    /// Listens where the command says.
    ///
    /// # Errors
    /// [`Code::Io`] where the address cannot be listened on; the system has no random numbers.
    pub fn open(args: &'a ViewArgs) -> Result<Door<'a>> {
        let listener = listen(SocketAddr::new(args.bind, args.port))?;
        let address =
            listener.local_addr().map_err(|error| refused(SocketAddr::new(args.bind, args.port), &error))?;
        Ok(Door { args, listener, address, token: Token::random()?, is_told: false })
    }

    /// How a session is served here.
    pub fn options(&self, frames: FrameOptions, follows_page: bool) -> ServeOptions {
        ServeOptions {
            token: self.token.clone(),
            hosts: self.args.host.clone(),
            frames,
            follows_page,
            embedders: Embedders::default(),
            silence_max: SILENCE_MAX,
        }
    }

    /// Listens again at the same address, after a server has ended there.
    ///
    /// # Errors
    /// [`Code::Io`] where another program has taken it.
    pub fn listen_again(&mut self) -> Result<()> {
        self.listener = listen(self.address)?;
        Ok(())
    }

    /// Tells where the page is, once, and opens it where there is a display and the browser is on this machine.
    pub fn tell(&mut self, ctx: &Context) {
        if std::mem::replace(&mut self.is_told, true) {
            return;
        }
        let Door { args, address, token, .. } = self;
        let host = match address.ip() {
            ip if ip.is_unspecified() => args.host.first().cloned().unwrap_or_else(|| "localhost".into()),
            IpAddr::V6(ip) => format!("[{ip}]"),
            IpAddr::V4(ip) => ip.to_string(),
        };
        let port = address.port();
        let url = format!("http://{host}:{port}/#token={}", token.digits());
        // It is of no use without its address: that is told even with --quiet.
        ctx.console.error(&url);
        let is_remote = std::env::var_os("SSH_CONNECTION").is_some();
        if !address.ip().is_loopback() {
            ctx.console.note(
                "note: others in the network can see the model, if they learn the token; nothing is encrypted",
            );
        } else if is_remote {
            ctx.console
                .note(&format!("from your own machine: ssh -L {port}:127.0.0.1:{port} {}", remote_name()));
        }
        let has_display = ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
        if !args.no_open && has_display && !is_remote {
            open_browser(&url, ctx);
        }
    }
}

fn listen(address: SocketAddr) -> Result<TcpListener> {
    TcpListener::bind(address).map_err(|error| refused(address, &error))
}

fn refused(address: SocketAddr, error: &std::io::Error) -> Error {
    Error::new(Code::Io, "cannot listen for the browser")
        .at_place(address.to_string())
        .numbers(error.to_string())
        .next("name another --port (0 takes any that is free) or another --bind")
}

/// What this machine is called where it was reached from, as far as it can know.
fn remote_name() -> String {
    let user = std::env::var("USER").unwrap_or_else(|_| "USER".into());
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_else(|_| "HOST".into());
    format!("{user}@{}", name.trim())
}

fn open_browser(url: &str, ctx: &Context) {
    let mut command = Command::new("xdg-open");
    command.arg(url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let opened = command.spawn().and_then(|mut child| {
        // It ends by itself; who waits for it is no part of what is shown.
        std::thread::Builder::new().name("view-open".into()).spawn(move || child.wait()).map(drop)
    });
    if let Err(error) = opened {
        ctx.console.note(&format!("note: no browser could be opened ({error}); open the address yourself"));
    }
}
