//! A network of other machines, where the test may make one: a namespace, joined to this machine by a cable that
//! can be pulled.

use std::net::{IpAddr, Ipv4Addr};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU8, Ordering};

/// Networks that this process has made.
static MADE: AtomicU8 = AtomicU8::new(0);

/// A network namespace of Linux; it is gone when this is.
#[derive(Debug)]
pub struct Namespace {
    name: String,
    here: IpAddr,
}

impl Namespace {
    /// Makes one; none where this process may not, or there is no `ip` (Debian and Ubuntu: iproute2).
    pub fn new() -> Option<Namespace> {
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let name = format!("gw{}-{number}", std::process::id());
        // Addresses for measurements between networks (RFC 2544): 64 networks of four for each process.
        let of =
            |last: u8| Ipv4Addr::new(198, 18, std::process::id() as u8, (number % 64) * 4 + last);
        ip(&["netns", "add", &name])?;
        let made = Namespace { here: of(1).into(), name };
        made.lay_cable(of(2).into())?;
        Some(made)
    }

    fn lay_cable(&self, there: IpAddr) -> Option<()> {
        let (name, near, far) = (self.name.as_str(), self.near(), "cable");
        let address = |ip: IpAddr| format!("{ip}/30");
        ip(&["link", "add", &near, "type", "veth", "peer", far, "netns", name])?;
        ip(&["address", "add", &address(self.here), "dev", &near])?;
        ip(&["link", "set", &near, "up"])?;
        ip(&["-n", name, "address", "add", &address(there), "dev", far])?;
        ip(&["-n", name, "link", "set", far, "up"])
    }

    /// The end of the cable at this machine.
    fn near(&self) -> String {
        format!("{}h", self.name)
    }

    /// The address of this machine as the other ones see it.
    pub fn here(&self) -> IpAddr {
        self.here
    }

    /// Pulls the cable, or plugs it in again.
    pub fn cut(&self, is_cut: bool) {
        let near = self.near();
        ip(&["link", "set", &near, if is_cut { "down" } else { "up" }]).unwrap();
    }

    /// The same command on another machine; what becomes of its input and outputs is to be said again, and
    /// what it is not to have of our environment.
    pub fn enter(&self, command: &Command) -> Command {
        let mut entered = Command::new("ip");
        entered.args(["netns", "exec", &self.name]).arg(command.get_program());
        entered.args(command.get_args()).stdin(Stdio::null());
        entered.envs(command.get_envs().filter_map(|(name, value)| Some((name, value?))));
        if let Some(folder) = command.get_current_dir() {
            entered.current_dir(folder);
        }
        entered
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        // The cable goes with it.
        ip(&["netns", "delete", &self.name]);
    }
}

/// Runs `ip`, if it does what is asked.
fn ip(arguments: &[&str]) -> Option<()> {
    let quiet =
        Command::new("ip").args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    quiet.ok()?.success().then_some(())
}
