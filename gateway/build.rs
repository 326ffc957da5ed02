//! Generates client and server of the calls between gateways; their messages are in `src/messages.rs`.

use tonic_build::manual::{Builder, Method, Service};

fn method(name: &str, route: &str, input: &str, output: &str) -> Method {
    let method = Method::builder().name(name).route_name(route);
    let method = method.input_type(format!("crate::messages::{input}"));
    let method = method.output_type(format!("crate::messages::{output}"));
    method.codec_path("tonic_prost::ProstCodec").build()
}

fn main() {
    let service = Service::builder()
        .name("Gateway")
        .package("goalward")
        .method(method("configuration", "Configuration", "ConfigurationRequest", "Configuration"))
        .method(method("hello", "Hello", "Hello", "Welcome"))
        .method(method("beat", "Beat", "Beat", "BeatReply"))
        .method(method("exchange", "Exchange", "Exchange", "Answer"))
        .method(method("goodbye", "Goodbye", "Goodbye", "Farewell"))
        .method(method("weights", "Weights", "WeightsRequest", "WeightsReply"))
        .build();
    Builder::new().compile(&[service]);
}
