import { mount } from "svelte";

import App from "./App.svelte";
import "./theme.css";

const target = document.getElementById("console");
if (target === null) throw new Error("expected the element #console in the page");
mount(App, { target });
