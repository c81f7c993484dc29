//! The names of elements in packages, which the writer and the reader share.

use anyhow::{Result, ensure};
use fmu_description::xml::Element;

/// The prefixes of the names below, as they are declared, and their namespaces.
pub const NAMESPACES: [(&str, &str); 6] = [
    ("xmlns:ssc", "http://ssp-standard.org/SSP1/SystemStructureCommon"),
    ("xmlns:ssd", "http://ssp-standard.org/SSP1/SystemStructureDescription"),
    ("xmlns:ssv", "http://ssp-standard.org/SSP1/SystemStructureParameterValues"),
    ("xmlns:osp", "http://opensimulationplatform.com/SSP/OSPAnnotations"),
    (
        "xmlns:oms",
        "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
    ),
    // Only read.
    ("xmlns:ssm", "http://ssp-standard.org/SSP1/SystemStructureParameterMapping"),
];

/// The type of components that are FMUs.
pub const FMU_TYPE: &str = "application/x-fmu-sharedlibrary";

/// The types of components that are systems in a file of their own: a structure, and a package.
pub const SYSTEM_TYPES: [&str; 2] = ["application/x-ssp-definition", "application/x-ssp-package"];

/// The types of connectors that have a unit.
pub const REALS: [&str; 3] = [REAL, FLOAT64, FLOAT32];

/// The types of parameters with real numbers.
pub const REAL_VALUES: [&str; 3] = [REAL_VALUE, FLOAT64_VALUE, FLOAT32_VALUE];

/// The types of parameters with whole numbers.
pub const WHOLE_VALUES: [&str; 9] = [
    INTEGER_VALUE,
    INT8_VALUE,
    INT16_VALUE,
    INT32_VALUE,
    INT64_VALUE,
    UINT8_VALUE,
    UINT16_VALUE,
    UINT32_VALUE,
    UINT64_VALUE,
];

macro_rules! elements {
    ($($name:ident = $text:literal;)*) => {
        $(pub const $name: &str = $text;)*
        const ELEMENTS: &[&str] = &[$($text),*];
    };
}

elements! {
    STRUCTURE = "ssd:SystemStructureDescription";
    SYSTEM = "ssd:System";
    ELEMENT_LIST = "ssd:Elements";
    COMPONENT = "ssd:Component";
    CONNECTORS = "ssd:Connectors";
    CONNECTOR = "ssd:Connector";
    CLOCK_OF_CONNECTOR = "ssd:Clock";
    CONNECTIONS = "ssd:Connections";
    CONNECTION = "ssd:Connection";
    ANNOTATIONS = "ssd:Annotations";
    BINDINGS = "ssd:ParameterBindings";
    BINDING = "ssd:ParameterBinding";
    VALUES = "ssd:ParameterValues";
    MAPPING_OF_BINDING = "ssd:ParameterMapping";
    EXPERIMENT = "ssd:DefaultExperiment";
    UNITS = "ssd:Units";
    UNIT = "ssc:Unit";
    BASE_UNIT = "ssc:BaseUnit";
    REAL = "ssc:Real";
    FLOAT64 = "ssc:Float64";
    FLOAT32 = "ssc:Float32";
    BINARY = "ssc:Binary";
    CLOCK = "ssc:Clock";
    DIMENSION = "ssc:Dimension";
    LINEAR = "ssc:LinearTransformation";
    ANNOTATION = "ssc:Annotation";
    PARAMETER_SET = "ssv:ParameterSet";
    PARAMETERS = "ssv:Parameters";
    PARAMETER = "ssv:Parameter";
    UNITS_OF_SET = "ssv:Units";
    REAL_VALUE = "ssv:Real";
    FLOAT64_VALUE = "ssv:Float64";
    FLOAT32_VALUE = "ssv:Float32";
    INTEGER_VALUE = "ssv:Integer";
    INT8_VALUE = "ssv:Int8";
    INT16_VALUE = "ssv:Int16";
    INT32_VALUE = "ssv:Int32";
    INT64_VALUE = "ssv:Int64";
    UINT8_VALUE = "ssv:UInt8";
    UINT16_VALUE = "ssv:UInt16";
    UINT32_VALUE = "ssv:UInt32";
    UINT64_VALUE = "ssv:UInt64";
    BOOLEAN_VALUE = "ssv:Boolean";
    STRING_VALUE = "ssv:String";
    ENUMERATION_VALUE = "ssv:Enumeration";
    BINARY_VALUE = "ssv:Binary";
    ELEMENT_VALUE = "ssv:Value";
    MAPPING = "ssm:ParameterMapping";
    MAPPING_ENTRY = "ssm:MappingEntry";
    OSP_FIXED_STEP = "osp:FixedStepAlgorithm";
    OMS_INFORMATION = "oms:SimulationInformation";
    OMS_MASTER = "oms:FixedStepMaster";
}

/// The namespaces that are declared where an element is.
type Scope<'a> = Vec<(&'a str, String)>;

/// The namespace of an element, if it has one, and its name in it.
fn resolve<'a, 's>(
    element: &Element<'a>,
    scope: &'s Scope<'a>,
) -> (Option<&'s str>, &'a str, &'a str) {
    let (prefix, local) = element.name.split_once(':').unwrap_or(("", element.name));
    let declares = |name: &str| name.trim_start_matches("xmlns").trim_start_matches(':') == prefix;
    let declared = scope.iter().rfind(|(name, _)| declares(name));
    (declared.map(|(_, uri)| uri.as_str()), prefix, local)
}

/// Adds the namespaces that an element declares.
fn declare<'a>(element: &Element<'a>, scope: &mut Scope<'a>) {
    let declared = element.attributes.iter().filter(|(name, _)| name.starts_with("xmlns"));
    scope.extend(declared.map(|(name, uri)| (*name, uri.clone().into_owned())));
}

/// The namespace that the root of a document is in.
pub fn namespace(root: &Element<'_>) -> Option<String> {
    let mut scope = Scope::new();
    declare(root, &mut scope);
    resolve(root, &scope).0.map(str::to_owned)
}

/// Gives the elements of a parsed document the names above, whatever prefixes it declares. Others keep
/// only the local part of their names.
///
/// # Errors
/// A prefix is not declared; in annotations, this does no harm.
pub fn normalize<'a>(element: &mut Element<'a>) -> Result<()> {
    normalize_in(element, &Scope::new(), false)
}

fn normalize_in<'a>(element: &mut Element<'a>, outer: &Scope<'a>, is_lax: bool) -> Result<()> {
    let mut scope = outer.clone();
    declare(element, &mut scope);
    let (uri, prefix, local) = resolve(element, &scope);
    ensure!(
        is_lax || prefix.is_empty() || uri.is_some(),
        "line {}: the prefix {prefix} of {} is not declared",
        element.line,
        element.name
    );
    let known = NAMESPACES.iter().find(|(_, known)| Some(*known) == uri);
    let known = known.and_then(|(declaration, _)| {
        let mut names = ELEMENTS.iter();
        names.find(|name| name.split_once(':') == Some((&declaration["xmlns:".len()..], local)))
    });
    element.name = known.copied().unwrap_or(local);
    let is_lax = is_lax || element.name == ANNOTATIONS;
    element.children.iter_mut().try_for_each(|child| normalize_in(child, &scope, is_lax))
}
