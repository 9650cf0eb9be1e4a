// Starts Rerun's web viewer with the recording of this server, and nothing else.
"use strict";
const message = document.getElementById("message");
wasm_bindgen({ module_or_path: "re_viewer_bg.wasm" })
  .then(async () => {
    const handle = new wasm_bindgen.WebHandle({
      url: [new URL("run.rrd", location.href).href],
      hide_welcome_screen: true,
      enable_history: false,
      notebook: false,
      persist: false,
      theme: "dark",
    });
    await handle.start(document.getElementById("viewer"));
    message.remove();
    const look = setInterval(() => {
      if (handle.has_panicked()) {
        clearInterval(look);
        document.body.append(message);
        message.textContent = `Rerun has stopped: ${handle.panic_message()}`;
      }
    }, 1000);
  })
  .catch((error) => { message.textContent = `Rerun cannot be shown: ${error}`; });
