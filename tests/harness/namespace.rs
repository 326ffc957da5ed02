//! Stands in for another machine on the network, where the system allows it: a network namespace joined to this
//! machine by a virtual cable that can be pulled.

use std::net::{IpAddr, Ipv4Addr};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU8, Ordering};

/// Number of namespaces that this process has made.
static MADE: AtomicU8 = AtomicU8::new(0);

/// A Linux network namespace; it is deleted on drop.
#[derive(Debug)]
pub struct Namespace {
    name: String,
    here: IpAddr,
}

impl Namespace {
    /// Makes one; `None` if this process is not allowed to, or there is no `ip` (Debian and Ubuntu: iproute2).
    pub fn new() -> Option<Namespace> {
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let name = format!("gw{}-{number}", std::process::id());
        // Addresses reserved for benchmarks (RFC 2544): 64 networks of four addresses for each process.
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

    /// The name of the cable's end at this machine.
    fn near(&self) -> String {
        format!("{}h", self.name)
    }

    /// The address of this machine as seen from the namespace.
    pub fn here(&self) -> IpAddr {
        self.here
    }

    /// Pulls the cable, or plugs it in again.
    pub fn cut(&self, is_cut: bool) {
        let near = self.near();
        ip(&["link", "set", &near, if is_cut { "down" } else { "up" }]).unwrap();
    }

    /// Returns the same command, run inside the namespace. Its standard input is null; redirections of its outputs
    /// and removed environment variables must be set again.
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
        // This removes the cable, too.
        ip(&["netns", "delete", &self.name]);
    }
}

/// Runs `ip`; `None` if it fails.
fn ip(arguments: &[&str]) -> Option<()> {
    let quiet =
        Command::new("ip").args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
    quiet.ok()?.success().then_some(())
}
