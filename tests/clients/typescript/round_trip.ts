// From a study to a report with the types that openapi-typescript generates, and openapi-fetch.
// Usage: node round_trip.js URL
import createClient from "openapi-fetch";
import type { components, paths } from "./api.js";

type Schemas = components["schemas"];

const url = process.argv[2];
if (url === undefined) throw new Error("usage: round_trip URL");
const client = createClient<paths>({ baseUrl: url });

function expect<T>(answer: { data?: T; error?: unknown; response: Response }): T {
  if (answer.data === undefined) throw new Error(`${answer.response.status}: ${JSON.stringify(answer.error)}`);
  return answer.data;
}

async function finished(analysis: { id: string }) {
  for (let i = 0; i < 600; i++) {
    const path = { analysis: analysis.id };
    const state = expect(await client.GET("/v1/analyses/{analysis}", { params: { path } }));
    if (state.status === "succeeded" || state.status === "failed" || state.status === "cancelled") return state;
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
  throw new Error("the analysis did not end within 30 s");
}

async function report(request: Schemas["Request"]) {
  const analysis = expect(await client.POST("/v1/analyses", { body: request }));
  const state = await finished(analysis);
  if (state.status !== "succeeded") throw new Error(JSON.stringify(state.problem));
  return expect(await client.GET("/v1/analyses/{analysis}/report", { params: { path: { analysis: analysis.id } } }));
}

const study = expect(await client.POST("/v1/studies", { body: { name: "A generated client in TypeScript" } }));
const inStudy = { params: { path: { study: study.id } } };
const model: Schemas["TransferFunctionModel"] = { num: [1], den: [1, 1] };
const plant = expect(await client.POST("/v1/studies/{study}/plants", { ...inStudy, body: { name: "lag", model } }));
const subject = expect(await client.POST("/v1/studies/{study}/subjects", { ...inStudy, body: { code: "s01" } }));

// The output is the command, a sample later: e^{-j omega T}.
const r = Array.from({ length: 64 }, (_, i) => Math.sin((Math.PI * i) / 4) + 1);
const y = r.map((_, i) => r[(i + 63) % 64]!);
const recording: Schemas["NewTrial"] = { sample_time_s: 0.5, r, u: y.map((value) => 0.1 * value), y };
const uploaded = expect(
  await client.POST("/v1/subjects/{subject}/trials", {
    params: { path: { subject: subject.id }, query: { plant: plant.id, number: 1 } },
    body: recording,
  }),
);
if (!("id" in uploaded)) throw new Error("a single trial was uploaded, and a list came back");

const response = await report({ kind: "frequency_response", inputs: { trial: uploaded.id } });
if (response.kind !== "frequency_response") throw new Error(response.kind);
const phase = response.result.phase_deg[response.result.frequency_hz.indexOf(0.25)];
if (phase === null || phase === undefined || Math.abs(phase + 45) > 1e-9) throw new Error(`phase ${phase}`);

const inputs: Schemas["InverseLqrInputs"] = { a: [[0, 1], [2, 0]], b: [[0], [1]], k: [[5, 4]] };
const answer = await report({ kind: "inverse_lqr", inputs });
if (answer.kind !== "inverse_lqr" || answer.result.verdict !== "feasible") throw new Error(JSON.stringify(answer));
console.log("typescript: a study, a trial and two reports, typed");
