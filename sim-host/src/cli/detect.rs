//! `sim-host detect`: the detector's campaign.
use super::{BAD_INPUT, Failure, LOSSES_PERCENT, With, folder_in, load, name_of, say};
use crate::controllers::ControllerName;
use crate::detection::{Campaign, PICTURE, Page, Results, refusal, svg};
use crate::figures::png;
use crate::output::Files;
use clap::Args;
use control_core::DetectorConfig;
use indicatif::ProgressBar;
use std::fmt::Write;
use std::path::{Path, PathBuf};

#[derive(Args)]
pub(super) struct DetectArgs {
    /// The scenario, a TOML file without a fault; a healthy flight is as long as it says.
    scenario: PathBuf,
    #[command(flatten)]
    with: With,
    /// Losses of one rotor, %, separated by commas.
    #[arg(long, value_delimiter = ',', default_values_t = LOSSES_PERCENT, value_parser = clap::value_parser!(u32).range(1..=100))]
    losses: Vec<u32>,
    /// Flights of each loss.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    flights: u64,
    /// Hours without a fault; zero leaves out the ROC.
    #[arg(long, default_value_t = 10.0, value_parser = number::<0, 1000>)]
    healthy_hours: f64,
    /// First seed; the scenario's if left out.
    #[arg(long)]
    seed: Option<u64>,
    /// Another torque of the air than the scenario's, root mean square, N m.
    #[arg(long, value_parser = number::<0, 100>)]
    torque_rms: Option<f64>,
    /// Another force of the gusts than the scenario's, root mean square, N.
    #[arg(long, value_parser = number::<0, 100>)]
    gust_rms: Option<f64>,
    /// Another threshold of the alarm than the one that flies, nats.
    #[arg(long)]
    alarm_nats: Option<f32>,
    /// Another loss to be looked for than the one that flies, as a share.
    #[arg(long)]
    sought_loss: Option<f32>,
    /// Where results go; `out/detection/<scenario>` if left out.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// A number from `LOW` to `HIGH`.
fn number<const LOW: u32, const HIGH: u32>(text: &str) -> Result<f64, String> {
    let allowed = f64::from(LOW)..=f64::from(HIGH);
    let number = text.parse().ok().filter(|number| allowed.contains(number));
    number.ok_or_else(|| format!("must be a number from {LOW} to {HIGH}"))
}

pub(super) fn detect(args: &DetectArgs) -> Result<(), Failure> {
    let mut scenario = load(&args.scenario, &args.with)?;
    let file = args.scenario.display();
    if let Some(reason) = refusal(&scenario) {
        return Err(Failure::bad_input(format!("{file}: {reason}")));
    }
    let folder = folder_in(args.out.as_ref(), Path::new("out/detection"), &args.scenario)?;
    scenario.wind.torque_rms_nm = args.torque_rms.unwrap_or(scenario.wind.torque_rms_nm);
    scenario.wind.gust_rms_n = args.gust_rms.unwrap_or(scenario.wind.gust_rms_n);
    let nominal = DetectorConfig::NOMINAL;
    let campaign = Campaign {
        detector: DetectorConfig {
            alarm_nats: args.alarm_nats.unwrap_or(nominal.alarm_nats),
            loss: args.sought_loss.unwrap_or(nominal.loss),
            ..nominal
        },
        seed: args.seed.unwrap_or(scenario.seed),
        losses: args.losses.iter().map(|&percent| f64::from(percent) / 100.0).collect(),
        flights: args.flights,
        healthy_flights: (args.healthy_hours * 3600.0 / scenario.duration_s).ceil() as u64,
        scenario: &scenario,
    };
    let bar = ProgressBar::new(campaign.count());
    let results = campaign.fly(&|| bar.inc(1));
    bar.finish_and_clear();
    let results = results
        .map_err(|error| Failure::bad_input(format!("{file}: controllers.{}: {error}", ControllerName::Default)))?;
    write(&results, &campaign, &folder, args)?;
    let where_to = format!("detection.html, detection.json and the ROC are in {}", folder.display());
    say(&format!("{}{where_to}\n", results.table(&campaign)))
}

fn write(results: &Results, campaign: &Campaign, folder: &Path, args: &DetectArgs) -> Result<(), Failure> {
    let name = name_of(&args.scenario);
    let mut files = Files::default();
    let roc = if campaign.healthy_flights == 0 || results.roc.losses().next().is_none() {
        None
    } else {
        let undrawn = |error: Box<dyn std::error::Error>| Failure {
            text: format!("the ROC cannot be drawn: {error}"),
            code: BAD_INPUT - 1,
        };
        let svg = svg(&results.roc).map_err(undrawn)?;
        files.add(format!("{PICTURE}.png"), png(&svg).map_err(undrawn)?);
        files.add(format!("{PICTURE}.svg"), svg.clone());
        Some(svg)
    };
    let page = Page { name: &name, command: &command_line(args, campaign), svg: roc.as_deref() };
    files.add("detection.html", results.html(&page, campaign));
    files.add("detection.json", format!("{:#}\n", results.json(&name, campaign)));
    files.write(folder).map_err(Failure::writing(folder))
}

/// The command that makes the same campaign again.
fn command_line(args: &DetectArgs, campaign: &Campaign) -> String {
    let losses: Vec<_> = args.losses.iter().map(u32::to_string).collect();
    let wind = &campaign.scenario.wind;
    let mut line = format!(
        "sim-host detect {} --losses {} --flights {} --healthy-hours {} --seed {}",
        args.scenario.display(),
        losses.join(","),
        args.flights,
        args.healthy_hours,
        campaign.seed,
    );
    if args.torque_rms.is_some() {
        let _ = write!(line, " --torque-rms {}", wind.torque_rms_nm);
    }
    if args.gust_rms.is_some() {
        let _ = write!(line, " --gust-rms {}", wind.gust_rms_n);
    }
    let detector = &campaign.detector;
    let _ = write!(line, " --alarm-nats {} --sought-loss {}", detector.alarm_nats, detector.loss);
    line
}
