//! The HTML page of a model. It is also well-formed XML, and needs no network, scripts or other files.

use fmu_description::xml::{Element, escape};
use fmu_description::{Causality, DeclaredType, EnumerationItem, ModelDescription};

use crate::library::NamedFile;
use crate::sources::{Memory, Sources};
use crate::table;

/// The style, which each FMU contains, without comments. Chromium shrinks accents like scripts, so that the dots of
/// derivatives could not be counted; on a phone, a variable is a paragraph instead of a row.
const STYLE: &str = include_str!("style.css");

/// Generates the page of the FMU `file`; `about` is an HTML fragment for its middle, and `icon` the path
/// of the icon in the FMU.
pub fn html(
    model: &ModelDescription<'_>,
    file: &str,
    about: Option<&str>,
    icon: Option<&str>,
    licenses: &[NamedFile],
    sources: Option<&Sources>,
) -> String {
    let name = escape(model.name());
    let what = escaped(model.root, "description");
    // Visible only if the whole FMU is unpacked.
    let icon = icon.map_or(String::new(), |path| {
        format!("<img src=\"../{path}\" alt=\"\" width=\"64\" height=\"64\"/>\n")
    });
    let title = if what.is_empty() { name.to_string() } else { format!("{name}: {what}") };
    let version = model
        .root
        .attribute("version")
        .map_or(String::new(), |version| format!("<br/>version {}", escape(version)));
    [
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n",
        "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n",
        &format!("<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n"),
        &format!(
            "<body>\n<header>\n{icon}<h1>{name}</h1>\n<p>{what}{version}</p>\n</header>\n<main>\n"
        ),
        about.unwrap_or_default().trim_end(),
        &usage(model, file),
        &variables(model),
        &capabilities(model),
        &sources.map(in_c).unwrap_or_default(),
        &identity(model.root, licenses),
        "</main>\n</body>\n</html>\n",
    ]
    .concat()
}

/// General instructions for using the FMU.
fn usage(model: &ModelDescription<'_>, file: &str) -> String {
    let named = |causality| -> String {
        let names: Vec<_> = model
            .variables()
            .filter(|(_, v)| v.causality == causality)
            .map(|(_, v)| format!("<code>{}</code>", escape(&v.name)))
            .collect();
        match names.len() {
            0 => "none".into(),
            _ => names.join(", "),
        }
    };
    format!(
        "\n<h2>Use</h2>\n<ul>\n\
        <li>Import <code>{file}</code> for {kinds}, FMI {version}.</li>\n\
        <li>Connect the inputs ({inputs}) and the outputs ({outputs}).</li>\n\
        <li>Set fixed parameters before the initialization, tunable ones at any time.</li>\n\
        {experiment}</ul>\n",
        file = escape(file),
        kinds = interfaces(model).map(|(_, kind)| kind).collect::<Vec<_>>().join(" or "),
        version = escaped(model.root, "fmiVersion"),
        inputs = named(Causality::Input),
        outputs = named(Causality::Output),
        experiment = default_experiment(model),
    )
}

fn default_experiment(model: &ModelDescription<'_>) -> String {
    let times = [
        ("starts at", "startTime"),
        ("stops at", "stopTime"),
        ("has communication steps of", "stepSize"),
    ];
    let tolerance = model.experiment("tolerance");
    let known: Vec<_> = times
        .into_iter()
        .filter_map(|(what, name)| Some(format!("{what} {} s", model.experiment(name)?)))
        .chain(tolerance.map(|value| format!("has a relative tolerance of {value:?}")))
        .collect();
    match known.len() {
        0 => String::new(),
        _ => format!("<li>The default experiment {}.</li>\n", known.join(", ")),
    }
}

fn variables(model: &ModelDescription<'_>) -> String {
    let head = cells("th scope=\"col\"", table::HEAD);
    let body: String = table::rows(model)
        .map(|[name, others @ ..]| {
            let name = cells("th scope=\"row\"", [name]);
            format!("<tr>{name}{}</tr>\n", cells("td", others))
        })
        .collect();
    let choices: String = model.enumerations().map(|of_type| choices(&of_type)).collect();
    format!(
        "<h2>Variables</h2>\n\
        <div class=\"wide\" role=\"region\" aria-label=\"Variables\" tabindex=\"0\">\n\
        <table id=\"variables\">\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody>\n</table>\n</div>\n\
        {choices}"
    )
}

/// The items of an enumeration.
fn choices(of_type: &DeclaredType) -> String {
    let item = |item: &EnumerationItem| {
        let (name, about) = (escape(&item.name), escape(&item.description));
        format!("<dt><code>{name}</code> = {}</dt><dd>{about}</dd>\n", item.value)
    };
    let items: String = of_type.items.iter().map(item).collect();
    let (name, about) = (escape(&of_type.name), escape(&of_type.description));
    format!("<h3>{name}</h3>\n<p>{about}:</p>\n<dl>\n{items}</dl>\n")
}

/// The types of interfaces that the FMU has, and their names in a sentence.
fn interfaces<'a>(
    model: &ModelDescription<'a>,
) -> impl Iterator<Item = (&'a Element<'a>, &'static str)> {
    let root = model.root;
    let kinds = [
        ("CoSimulation", "co-simulation"),
        ("ModelExchange", "model exchange"),
        ("ScheduledExecution", "scheduled execution"),
    ];
    kinds.into_iter().filter_map(move |(element, kind)| Some((root.child(element)?, kind)))
}

/// The capabilities, as the model description has them.
fn capabilities(model: &ModelDescription<'_>) -> String {
    interfaces(model)
        .map(|(interface, kind)| {
            let rows: String = interface
                .attributes
                .iter()
                .filter(|(name, _)| *name != "modelIdentifier")
                .map(|(name, value)| {
                    let value = match &**value {
                        "true" => "yes",
                        "false" => "no",
                        number => number,
                    };
                    let (name, value) = (escape(*name), escape(value));
                    format!("<tr><th scope=\"row\">{name}</th><td>{value}</td></tr>\n")
                })
                .collect();
            format!(
                "<h2>Capabilities for {kind}</h2>\n<table>\n<tbody>\n{rows}</tbody>\n</table>\n"
            )
        })
        .collect()
}

/// What the C sources need.
fn in_c(sources: &Sources) -> String {
    let Memory { total, stack } = sources.memory;
    let files = sources.compiled.iter().map(|file| format!("<code>{}</code>", escape(file)));
    let files = Vec::from_iter(files).join(" and ");
    format!(
        "<h2>C sources</h2>\n<ul>\n\
        <li>Compile {files} in the folder <code>sources</code> with any C99 compiler, as <code>buildDescription.xml</code> \
        and <a href=\"staticLinking.txt\">staticLinking.txt</a> say.</li>\n\
        <li>An instance is one block of memory, in which the model has {total} bytes, {stack} of them for the stack.</li>\n\
        </ul>\n"
    )
}

/// Where the FMU comes from.
fn identity(root: &Element<'_>, licenses: &[NamedFile]) -> String {
    let links: Vec<_> = licenses
        .iter()
        .map(|(path, _)| {
            let path = escape(path);
            let name = path.rsplit('/').next().unwrap_or_default();
            format!("<a href=\"{path}\">{name}</a>")
        })
        .collect();
    let text = |name| Some(escape(root.attribute(name)?).into_owned());
    let license: Vec<String> = text("license").into_iter().chain(links).collect();
    let lines = [
        ("GUID", text("guid").or_else(|| text("instantiationToken"))),
        ("Exported with", text("generationTool")),
        ("Author", text("author")),
        ("Copyright", text("copyright")),
        ("Licence", (!license.is_empty()).then(|| license.join(", "))),
    ];
    let lines: String = lines
        .into_iter()
        .filter_map(|(name, value)| Some(format!("<dt>{name}</dt><dd>{}</dd>\n", value?)))
        .collect();
    format!("<h2>This FMU</h2>\n<dl>\n{lines}</dl>\n")
}

/// Cells of a table; `tag` may have attributes.
fn cells<const N: usize>(tag: &str, texts: [impl AsRef<str>; N]) -> String {
    let end = tag.split(' ').next().unwrap_or_default();
    texts.iter().map(|text| format!("<{tag}>{}</{end}>", escape(text.as_ref()))).collect()
}

/// An attribute escaped for HTML; empty if missing.
fn escaped(element: &Element<'_>, attribute: &str) -> String {
    escape(element.attribute(attribute).unwrap_or_default()).into_owned()
}

#[cfg(test)]
mod tests {
    use fmu_description::xml::parse;

    use super::*;

    const XML: &str = r#"<fmiModelDescription fmiVersion="2.0" modelName="A" guid="{1}"
        description="x &lt; y &amp; &quot;z&quot;" version="1.2" license="MIT" author="B &amp; C" copyright="© B">
        <ModelExchange modelIdentifier="A"/><CoSimulation modelIdentifier="A" canInterpolateInputs="true"
        maxOutputDerivativeOrder="1"/><TypeDefinitions><SimpleType name="Form" description="shape"><Enumeration>
        <Item name="round" value="3" description="a &lt; b"/></Enumeration></SimpleType></TypeDefinitions>
        <DefaultExperiment stopTime="2"/>
        <ModelVariables>
        <ScalarVariable name="u" valueReference="0" causality="input"><Real start="0" unit="N"/></ScalarVariable>
        <ScalarVariable name="f" valueReference="1" causality="parameter" variability="fixed">
        <Enumeration declaredType="Form" start="3"/></ScalarVariable>
        </ModelVariables><ModelStructure/></fmiModelDescription>"#;

    #[test]
    fn the_page_shows_the_model_description() {
        let root = parse(XML).unwrap();
        let model = ModelDescription::new(&root);
        let licenses = [("licenses/LICENSE-A&B".to_owned(), Vec::new())];
        let about = Some("<h2>About</h2>\n");
        let page = html(&model, "A.fmu", about, Some("model.png"), &licenses, None);
        parse(page.strip_prefix("<!DOCTYPE html>\n").unwrap()).unwrap();
        let bare = html(&model, "A.fmu", None, None, &licenses, None);
        parse(bare.strip_prefix("<!DOCTYPE html>\n").unwrap()).unwrap();
        assert!(!bare.contains("model.png"));
        for text in [
            "<img src=\"../model.png\"",
            "<main>\n<h2>About</h2>\n<h2>",
            "<title>A: x &lt; y &amp; &quot;z&quot;</title>",
            "<li>Import <code>A.fmu</code> for co-simulation or model exchange, FMI 2.0.</li>",
            "<h2>Capabilities for model exchange</h2>",
            "<th scope=\"row\">canInterpolateInputs</th><td>yes</td>",
            "<th scope=\"row\">maxOutputDerivativeOrder</th><td>1</td>",
            "(<code>u</code>) and the outputs (none)",
            "<li>The default experiment stops at 2 s.</li>",
            "<td>N</td><td>0</td>",
            "<td>Enumeration</td><td></td><td>round</td>",
            "<dt><code>round</code> = 3</dt><dd>a &lt; b</dd>",
            "<br/>version 1.2</p>",
            "<dt>GUID</dt><dd>{1}</dd>",
            "<dt>Author</dt><dd>B &amp; C</dd>\n<dt>Copyright</dt><dd>© B</dd>",
            "<dd>MIT, <a href=\"licenses/LICENSE-A&amp;B\">LICENSE-A&amp;B</a></dd>",
        ] {
            assert!(page.contains(text), "{text} is missing in:\n{page}");
        }
    }
}
