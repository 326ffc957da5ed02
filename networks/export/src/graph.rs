//! A graph of operators under construction, and the two file formats it can be written as.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::Path;

use prost::Message;
use safetensors::tensor::{Dtype, SafeTensorError, TensorView};

use crate::message::{
    AttributeProto, Dimension, DimensionProto, GraphProto, IR_VERSION, Kind, ModelProto, NodeProto,
    OPERATORS, OperatorSetIdProto, StringStringEntryProto, TensorProto, TensorShapeProto,
    TensorTypeProto, TypeProto, ValueInfoProto,
};

/// `AttributeProto.AttributeType` of an integer.
const INT: i32 = 2;

/// `AttributeProto.AttributeType` of several integers.
const INTS: i32 = 7;

/// Name prefix of initializers that are constants, not weights.
const CONSTANT: &str = "constant.";

/// An exported model: operators over any number of rows, weights, and metadata.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Graph {
    proto: GraphProto,
    metadata: BTreeMap<String, String>,
}

/// Name of an input or output of an operator.
pub(crate) type Name = String;

impl Graph {
    pub(crate) fn new(name: &str) -> Graph {
        let proto = GraphProto { name: name.to_owned(), ..GraphProto::default() };
        Graph { proto, metadata: BTreeMap::new() }
    }

    /// Sets the metadata.
    pub fn with(mut self, metadata: BTreeMap<String, String>) -> Graph {
        self.metadata = metadata;
        self
    }

    /// Adds an input of rows with this shape.
    pub(crate) fn input(&mut self, name: &str, kind: Kind, row: &[usize]) -> Name {
        self.proto.input.push(value_info(name, kind, row));
        name.to_owned()
    }

    /// Adds a value as an output of rows with this shape.
    pub(crate) fn output(&mut self, value: &str, name: &str, kind: Kind, row: &[usize]) {
        self.append("Identity", &[value], &[name.to_owned()], Vec::new());
        self.proto.output.push(value_info(name, kind, row));
    }

    /// Adds a weight.
    pub(crate) fn weight(&mut self, name: &str, shape: &[usize], numbers: &[f32]) -> Name {
        let bytes = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        self.tensor(name.to_owned(), Kind::F32, shape, bytes)
    }

    /// Adds a weight in double precision.
    pub(crate) fn double_weight(&mut self, name: &str, numbers: &[f64]) -> Name {
        let bytes = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        self.tensor(name.to_owned(), Kind::F64, &[numbers.len()], bytes)
    }

    /// Adds a single number as a constant.
    pub(crate) fn number(&mut self, number: f32) -> Name {
        self.constant(Kind::F32, &[], number.to_le_bytes().to_vec())
    }

    /// Adds a single number in double precision as a constant.
    pub(crate) fn double(&mut self, number: f64) -> Name {
        self.constant(Kind::F64, &[], number.to_le_bytes().to_vec())
    }

    /// Adds a single integer as a constant.
    pub(crate) fn integer(&mut self, number: i64) -> Name {
        self.constant(Kind::I64, &[], number.to_le_bytes().to_vec())
    }

    /// Adds a vector of numbers as a constant.
    pub(crate) fn numbers(&mut self, numbers: &[f32]) -> Name {
        let bytes = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        self.constant(Kind::F32, &[numbers.len()], bytes)
    }

    fn constant(&mut self, kind: Kind, shape: &[usize], bytes: Vec<u8>) -> Name {
        let name = format!("{CONSTANT}{}", self.proto.initializer.len());
        self.tensor(name, kind, shape, bytes)
    }

    fn tensor(&mut self, name: Name, kind: Kind, shape: &[usize], raw_data: Vec<u8>) -> Name {
        let dims = shape.iter().map(|&side| side as i64).collect();
        let data_type = kind as i32;
        self.proto.initializer.push(TensorProto { dims, data_type, name: name.clone(), raw_data });
        name
    }

    /// Adds an operator and returns the name of its output.
    pub(crate) fn node(&mut self, operator: &str, inputs: &[&str]) -> Name {
        self.node_with(operator, inputs, Vec::new())
    }

    /// Adds an operator with attributes and returns the name of its output.
    pub(crate) fn node_with(
        &mut self,
        operator: &str,
        inputs: &[&str],
        attributes: Vec<AttributeProto>,
    ) -> Name {
        let output = format!("{}.{}", operator.to_lowercase(), self.proto.node.len());
        self.append(operator, inputs, std::slice::from_ref(&output), attributes);
        output
    }

    /// Splits each row into its first and second half.
    pub(crate) fn halves(&mut self, value: &str) -> [Name; 2] {
        let halves = ["first", "second"].map(|half| format!("{value}.{half}"));
        self.append("Split", &[value], &halves, vec![integer("axis", 1)]);
        halves
    }

    /// Casts a value to another kind of number.
    pub(crate) fn cast(&mut self, value: &str, kind: Kind) -> Name {
        self.node_with("Cast", &[value], vec![integer("to", kind as i64)])
    }

    fn append(
        &mut self,
        operator: &str,
        inputs: &[&str],
        outputs: &[Name],
        attribute: Vec<AttributeProto>,
    ) {
        self.proto.node.push(NodeProto {
            input: inputs.iter().map(|&name| name.to_owned()).collect(),
            output: outputs.to_vec(),
            name: outputs[0].clone(),
            op_type: operator.to_owned(),
            attribute,
        });
    }

    /// Encodes the model in the format of the file name's extension: `.onnx`, or `.safetensors` for the weights
    /// alone.
    ///
    /// # Errors
    /// When the name has another extension, or safetensors cannot hold the weights.
    pub fn to_file(&self, name: &Path) -> Result<Vec<u8>, String> {
        match name.extension().and_then(OsStr::to_str) {
            Some("onnx") => Ok(self.to_onnx()),
            Some("safetensors") => self.to_safetensors().map_err(|error| error.to_string()),
            _ => Err(format!("{}: expected .onnx or .safetensors at its end", name.display())),
        }
    }

    /// Encodes the model as an ONNX file.
    pub fn to_onnx(&self) -> Vec<u8> {
        let entry = |(key, value): (&String, &String)| StringStringEntryProto {
            key: key.clone(),
            value: value.clone(),
        };
        let operators = OperatorSetIdProto { domain: String::new(), version: OPERATORS };
        let model = ModelProto {
            ir_version: IR_VERSION,
            producer_name: "goalward".to_owned(),
            producer_version: env!("CARGO_PKG_VERSION").to_owned(),
            graph: Some(self.proto.clone()),
            opset_import: vec![operators],
            metadata_props: self.metadata.iter().map(entry).collect(),
        };
        model.encode_to_vec()
    }

    /// Encodes the model's weights as a safetensors file, under their names in the ONNX file.
    ///
    /// # Errors
    /// When safetensors cannot hold them.
    pub fn to_safetensors(&self) -> Result<Vec<u8>, SafeTensorError> {
        let weights = self.proto.initializer.iter();
        let weights = weights.filter(|tensor| !tensor.name.starts_with(CONSTANT));
        let views: Vec<_> = weights.map(view).collect::<Result<_, _>>()?;
        safetensors::serialize(views, Some(self.metadata.clone().into_iter().collect()))
    }
}

/// Returns a weight as safetensors needs it: its name, kind, shape and bytes.
fn view(tensor: &TensorProto) -> Result<(&str, TensorView<'_>), SafeTensorError> {
    let TensorProto { dims, data_type, name, raw_data } = tensor;
    let kind = if *data_type == Kind::F64 as i32 { Dtype::F64 } else { Dtype::F32 };
    let shape = dims.iter().map(|&side| side as usize).collect();
    Ok((name, TensorView::new(kind, shape, raw_data)?))
}

/// Creates an integer attribute.
pub(crate) fn integer(name: &str, i: i64) -> AttributeProto {
    AttributeProto { name: name.to_owned(), i, ints: Vec::new(), r#type: INT }
}

/// Creates an attribute of several integers.
pub(crate) fn integers(name: &str, ints: &[i64]) -> AttributeProto {
    AttributeProto { name: name.to_owned(), i: 0, ints: ints.to_vec(), r#type: INTS }
}

fn value_info(name: &str, kind: Kind, row: &[usize]) -> ValueInfoProto {
    let batch = Dimension::Param("batch".to_owned());
    let sides = row.iter().map(|&side| Dimension::Value(side as i64));
    let dim = std::iter::once(batch).chain(sides);
    let dim = dim.map(|value| DimensionProto { value: Some(value) }).collect();
    let shape = Some(TensorShapeProto { dim });
    let tensor_type = TensorTypeProto { elem_type: kind as i32, shape };
    let r#type = Some(TypeProto { tensor_type: Some(tensor_type) });
    ValueInfoProto { name: name.to_owned(), r#type }
}
