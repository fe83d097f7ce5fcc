//! What `tune` and `report` print while they measure.

use engine::Event;
use trade::bench::Observer;

use super::output::remark;
use super::words::forecast_text;

/// Prints the forecast of the first setting, which others are compared with and which takes longest.
pub fn forecast_of_the_first<'e>() -> Observer<'e> {
    Box::new(|name, before, event| match event {
        Event::Plan(forecast) if before == 0 && forecast.open > 0 => {
            let about = forecast_text(forecast);
            remark(&format!("measuring `{name}` first, which others are compared with: {about}"));
        }
        _ => {}
    })
}
