//! Keys of a run that other hosts can join. The run is its own certificate authority, which certifies only the hub and
//! one key that all hosts share. Whoever has the run's file `join.toml` can join it, nobody else.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use protocol::durable;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use run::folder::RunFolder;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tonic::transport::{Certificate, ClientTlsConfig, Identity, ServerTlsConfig};

/// Name in the hub's certificate, independent of the hub's address.
const HUB: &str = "goalward-hub";

/// The address and the keys that a host needs to join a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JoinKey {
    /// Address at which hosts reach the hub, `HOST:PORT`.
    pub address: String,
    authority: String,
    certificate: String,
    key: String,
}

/// The certificates and the key of the hub.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HubKey {
    authority: String,
    certificate: String,
    key: String,
}

fn hub_file(folder: &RunFolder) -> PathBuf {
    folder.path().join("hub.toml")
}

/// Returns the keys of a run. Existing keys are kept, so that hosts of an earlier start can come back; otherwise new
/// ones are made. Writes `address` into the file that hosts join with.
///
/// # Errors
/// When a file cannot be read or written, or does not contain keys.
pub fn of_run(folder: &RunFolder, address: &str) -> Result<HubKey> {
    let (join_file, hub_file) = (folder.join_file(), hub_file(folder));
    let (mut join, hub) = if join_file.exists() && hub_file.exists() {
        (read::<JoinKey>(&join_file)?, read(&hub_file)?)
    } else {
        let (join, hub) = made().context("making the keys of the run")?;
        write(&hub_file, &hub)?;
        (join, hub)
    };
    address.clone_into(&mut join.address);
    write(&join_file, &join)?;
    Ok(hub)
}

fn made() -> Result<(JoinKey, HubKey), rcgen::Error> {
    let key = KeyPair::generate()?;
    let mut authority = CertificateParams::new(Vec::new())?;
    authority.distinguished_name.push(DnType::CommonName, "Goalward run");
    authority.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    authority.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    let certificate = authority.self_signed(&key)?.pem();
    let issuer = Issuer::new(authority, key);
    let signed = |name: &str, usage| {
        let key = KeyPair::generate()?;
        let mut params = CertificateParams::new([name.to_owned()])?;
        params.distinguished_name.push(DnType::CommonName, name);
        params.extended_key_usages = vec![usage];
        Ok((params.signed_by(&key, &issuer)?.pem(), key.serialize_pem()))
    };
    let (hub, hub_key) = signed(HUB, ExtendedKeyUsagePurpose::ServerAuth)?;
    let (host, host_key) = signed("goalward-host", ExtendedKeyUsagePurpose::ClientAuth)?;
    let join = JoinKey {
        address: String::new(),
        authority: certificate.clone(),
        certificate: host,
        key: host_key,
    };
    Ok((join, HubKey { authority: certificate, certificate: hub, key: hub_key }))
}

fn read<T: DeserializeOwned>(file: &Path) -> Result<T> {
    let shown = || file.display().to_string();
    let text = fs::read_to_string(file).with_context(shown)?;
    let read = toml::from_str(&text).map_err(|error: toml::de::Error| {
        anyhow::anyhow!(
            "expected the keys that `goalward train --listen` writes: {}",
            error.message()
        )
    });
    read.with_context(shown)
}

fn write(file: &Path, key: &impl Serialize) -> Result<()> {
    let text = toml::to_string(key).context("writing keys")?;
    durable::write_private(file, text).with_context(|| file.display().to_string())
}

impl JoinKey {
    /// Reads the file that the hub has written.
    ///
    /// # Errors
    /// When the file cannot be read, or does not contain keys.
    pub fn of_file(file: &Path) -> Result<JoinKey> {
        read(file)
    }

    pub(crate) fn tls(&self) -> ClientTlsConfig {
        ClientTlsConfig::new()
            .domain_name(HUB)
            .ca_certificate(Certificate::from_pem(&self.authority))
            .identity(Identity::from_pem(&self.certificate, &self.key))
    }
}

impl HubKey {
    pub(crate) fn tls(&self) -> ServerTlsConfig {
        ServerTlsConfig::new()
            .client_ca_root(Certificate::from_pem(&self.authority))
            .identity(Identity::from_pem(&self.certificate, &self.key))
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn keys_are_private_and_outlast_a_restart() {
        let directory = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(directory.path());
        let hub = of_run(&folder, "one:1").unwrap();
        let first = JoinKey::of_file(&folder.join_file()).unwrap();
        assert_eq!(first.address, "one:1");
        for file in [folder.join_file(), hub_file(&folder)] {
            assert_eq!(fs::metadata(file).unwrap().permissions().mode() & 0o777, 0o600);
        }
        let again = of_run(&folder, "two:2").unwrap();
        let second = JoinKey::of_file(&folder.join_file()).unwrap();
        assert_eq!((hub.key, first.key), (again.key, second.key));
        assert_eq!(second.address, "two:2");
        fs::write(folder.join_file(), "address = 3").unwrap();
        let error = format!("{:#}", of_run(&folder, "two:2").unwrap_err());
        assert!(error.contains("join.toml: expected the keys"), "{error}");
    }
}
