//! Who may talk to the server: host names, origins, and the token.
//!
//! A page of another site cannot read what a loopback server says, but it can send to it, and a name of its own that
//! resolves to 127.0.0.1 makes it the same site. So the name by which the server was asked has to be one of ours, and
//! so has the site that a socket is opened from: that of the page itself, so the one by which the socket is asked, port
//! and all: another port of this machine is another program. Other users of the machine are kept out by the token.
//!
//! Nobody may show the page in a frame of another site but those who are named for it.
//!
//! Invariants: 1. a name is compared as a whole, its port only with that of an origin, since a tunnel may give the
//! server any; 2. tokens are compared in a time that says nothing of
//! where they differ, and never shown by `Debug`.

use std::net::IpAddr;
use trex_store::{Code, Error, Result};

/// Bytes of a token: 128 bits, which nobody guesses.
const TOKEN_BYTES: usize = 16;

/// The secret that a page has to say.
#[derive(Clone)]
pub struct Token(String);

impl Token {
    /// A new one.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn random() -> Result<Token> {
        let mut bytes = [0; TOKEN_BYTES];
        getrandom::fill(&mut bytes).map_err(|error| {
            Error::new(Code::Io, "the system gave no random numbers")
                .at_place("the token of the viewer")
                .numbers(error.to_string())
                .next("check that /dev/urandom can be read")
        })?;
        Ok(Token(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// The 32 hexadecimal digits, for the address that is printed. Nothing else may show them.
    pub fn digits(&self) -> &str {
        &self.0
    }

    /// True when `said` is this token.
    pub(crate) fn is(&self, said: &str) -> bool {
        let (ours, said) = (self.0.as_bytes(), said.as_bytes());
        let differs = ours.iter().zip(said).fold(0, |all, (a, b)| all | (a ^ b));
        ours.len() == said.len() && std::hint::black_box(differs) == 0
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(..)")
    }
}

/// Sites whose pages may have the page in a frame: nobody's, unless they are named.
#[derive(Clone, Debug)]
pub struct Embedders(String);

impl Default for Embedders {
    /// Nobody.
    fn default() -> Embedders {
        Embedders("'none'".to_owned())
    }
}

impl Embedders {
    /// These sites: each is a scheme and a host, with a port or `*` for any, or `'self'`.
    ///
    /// # Errors
    /// [`Code::Usage`] for text that is none of these: it could say more in the header than who may.
    pub fn new(sites: &[String]) -> Result<Embedders> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-._:/*[]".contains(c);
        let is_site = |site: &str| {
            let host = site.strip_prefix("http://").or(site.strip_prefix("https://"));
            site == "'self'" || host.is_some_and(|host| !host.is_empty() && host.chars().all(is_plain))
        };
        if let Some(site) = sites.iter().find(|site| !is_site(site)) {
            return Err(Error::new(Code::Usage, "this is no site that may show the page in a frame")
                .at_place("the embedders of the viewer")
                .numbers(format!("{site:?}"))
                .next("give sites like http://localhost:8888, http://localhost:* or 'self'"));
        }
        if sites.is_empty() { Ok(Embedders::default()) } else { Ok(Embedders(sites.join(" "))) }
    }

    /// As the header `frame-ancestors` has them.
    pub(crate) fn sources(&self) -> &str {
        &self.0
    }
}

/// The names that the server may be asked by.
#[derive(Clone, Debug)]
pub(crate) struct Hosts(Vec<String>);

impl Hosts {
    /// The names of this machine for itself, the address that is listened on, and `more`.
    pub(crate) fn new(bound: IpAddr, more: &[String]) -> Hosts {
        let ours = ["localhost".to_owned(), "127.0.0.1".to_owned(), "::1".to_owned()];
        let bound = (!bound.is_unspecified()).then(|| bound.to_string());
        let more = more.iter().map(|name| bare(name).unwrap_or(name).to_ascii_lowercase());
        Hosts(ours.into_iter().chain(bound).chain(more).collect())
    }

    /// True for the value of a `Host` header that names us, with any port or none.
    pub(crate) fn has(&self, host: &str) -> bool {
        bare(host).is_some_and(|name| self.0.iter().any(|ours| ours.eq_ignore_ascii_case(name)))
    }

    /// True for the value of an `Origin` header that is the site by which `host`, the `Host` header of the request,
    /// names us.
    pub(crate) fn has_origin(&self, origin: &str, host: &str) -> bool {
        let schemes = [("http://", "80"), ("https://", "443")];
        let site = schemes.iter().find_map(|(scheme, port)| Some((origin.strip_prefix(scheme)?, *port)));
        let Some((site, default_port)) = site else { return false };
        let (Some((name, port)), Some((asked, asked_port))) = (parts(site), parts(host)) else {
            return false;
        };
        self.has(site) && name.eq_ignore_ascii_case(asked) && is_same_port([port, asked_port], default_port)
    }
}

/// True for ports that are one, where those that are not said are `default`.
fn is_same_port(ports: [&str; 2], default: &str) -> bool {
    let [a, b] = ports.map(|port| if port.is_empty() { default } else { port }.trim_start_matches('0'));
    a == b
}

/// The name in `name`, `name:port`, `[address]` or `[address]:port`; `None` for anything else.
fn bare(host: &str) -> Option<&str> {
    parts(host).map(|(name, _)| name)
}

/// The name and the port in `name`, `name:port`, `[address]` or `[address]:port`, an empty one for none; `None` for
/// anything else.
fn parts(host: &str) -> Option<(&str, &str)> {
    let is_port = |port: &str| port.len() <= 5 && port.bytes().all(|byte| byte.is_ascii_digit());
    if let Some(rest) = host.strip_prefix('[') {
        let (address, after) = rest.split_once(']')?;
        let port = if after.is_empty() { "" } else { after.strip_prefix(':')? };
        return is_port(port).then_some((address, port));
    }
    match host.split_once(':') {
        None => Some((host, "")),
        Some((name, port)) if is_port(port) => Some((name, port)),
        // An address of version 6 without brackets, as users write it; no header has it so.
        Some(_) => host.parse::<IpAddr>().is_ok().then_some((host, "")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_differ_and_tell_nothing() {
        let [one, other] = [Token::random().unwrap(), Token::random().unwrap()];
        assert_eq!(one.digits().len(), 32);
        assert!(one.is(one.digits()) && !one.is(other.digits()));
        for wrong in ["", &one.digits()[..31], &format!("{}0", one.digits()), &one.digits().to_uppercase()] {
            assert!(!one.is(wrong) || wrong == one.digits(), "{wrong}");
        }
        assert_eq!(format!("{one:?}"), "Token(..)");
    }

    #[test]
    fn hosts_are_compared_as_a_whole_with_any_port() {
        let hosts = Hosts::new("192.168.1.7".parse().unwrap(), &["render.lan".into(), "[fe80::1]".into()]);
        let good = "localhost localhost:8000 LOCALHOST:1 127.0.0.1 127.0.0.1:65535 [::1] [::1]:80 192.168.1.7:9 \
                    render.lan:80 Render.LAN [fe80::1]:7";
        for host in good.split_whitespace() {
            assert!(hosts.has(host), "{host}");
        }
        let bad = "evil.com localhost.evil.com evil.localhost localhost:80:80 localhost:x localhost: 127.0.0.2 \
                   localhost. 127.0.0.1:123456 [::1 [::1]x [::1]:8x @localhost user@localhost ::2";
        for host in bad.split_whitespace().chain([""]).filter(|host| *host != "localhost:") {
            assert!(!hosts.has(host), "{host}");
        }
    }

    /// Names alone were compared: a page of any other program of this machine was a page of ours.
    #[test]
    fn an_origin_is_the_site_that_was_asked() {
        let hosts = Hosts::new("127.0.0.1".parse().unwrap(), &["render.lan".into()]);
        for (origin, host) in [
            ("http://127.0.0.1:4000", "127.0.0.1:4000"),
            ("http://LocalHost:80", "localhost"),
            ("http://localhost", "localhost:80"),
            ("https://render.lan", "render.lan:443"),
            ("https://render.lan", "render.lan"),
            ("http://[::1]:9", "[::1]:9"),
        ] {
            assert!(hosts.has_origin(origin, host), "{origin} at {host}");
        }
        for (origin, host) in [
            ("http://127.0.0.1:4000", "127.0.0.1:4001"),
            ("http://localhost:4000", "127.0.0.1:4000"),
            ("http://localhost", "localhost:4000"),
            ("http://localhost:4000", "localhost"),
            ("https://render.lan", "render.lan:80"),
            ("http://[::1]:9", "[::1]:8"),
            ("http://evil.com:4000", "evil.com:4000"),
        ] {
            assert!(!hosts.has_origin(origin, host), "{origin} at {host}");
        }
        for bad in ["null", "", "http://evil.com", "file://localhost", "http://localhost/x", "localhost"] {
            assert!(!hosts.has_origin(bad, "localhost"), "{bad}");
        }
    }

    #[test]
    fn an_address_for_all_is_no_name() {
        assert!(!Hosts::new("0.0.0.0".parse().unwrap(), &[]).has("0.0.0.0"));
    }

    #[test]
    fn embedders_are_sites_and_nothing_more() {
        let sources = |sites: &[&str]| {
            let sites: Vec<_> = sites.iter().map(|&site| site.to_owned()).collect();
            Embedders::new(&sites).map(|embedders| embedders.sources().to_owned())
        };
        assert_eq!(sources(&[]).unwrap(), "'none'");
        assert_eq!(sources(&["'self'", "https://a.example:*"]).unwrap(), "'self' https://a.example:*");
        for site in
            ["*", "", "http://", "data:", "http://a;script-src *", "http://a\r\nX: y", "http://a b", "'none'"]
        {
            assert_eq!(sources(&[site]).unwrap_err().code(), Code::Usage, "{site:?}");
        }
    }
}
