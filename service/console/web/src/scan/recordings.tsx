import { useState } from "preact/hooks";
import { api, resultOf, type Recording } from "../net/api";
import { request } from "../net/request";
import { changes } from "../state/scans";
import { decimal, when } from "../texts/format";
import { t } from "../texts/translate";
import { Failed, useAction } from "../ui/action";
import { Field } from "../ui/field";
import { useQuery } from "../ui/use_query";

const UPLOAD_S = 600;
const LISTED = 100;

interface RecordingsProps {
  chosen: string | null;
  choose: (id: string | null) => void;
}

/** The choice of a recording of the service, and the upload of a new one. */
export function Recordings({ chosen, choose }: RecordingsProps) {
  const [known, setKnown] = useState<Recording[] | null>(null);
  const upload = useAction();

  const failure = useQuery(
    () => resultOf(api.GET("/api/recordings", { params: { query: { limit: LISTED } } })),
    ({ recordings }) => setKnown(recordings),
    [changes.value],
  );

  async function send(file: File): Promise<void> {
    const added = await resultOf(
      api.POST("/api/recordings", {
        params: { query: { name: file.name } },
        // The description types a body of bytes as a string.
        body: file as unknown as string,
        bodySerializer: (body: unknown) => body as BodyInit,
        headers: { "Content-Type": "application/octet-stream" },
        fetch: (call) => request(call, UPLOAD_S),
      }),
    );
    setKnown([added, ...(known ?? []).filter((one) => one.id !== added.id)]);
    choose(added.id);
  }

  return (
    <div class="row wide">
      <Field label={t("scan.recordings.label")} hint="recording">
        {(id) => (
          <select id={id} value={chosen ?? ""} onChange={(event) => choose(event.currentTarget.value || null)}>
            <option value="">{known?.length === 0 ? t("scan.recordings.none") : t("scan.recordings.choose")}</option>
            {known?.map((one) => (
              <option key={one.id} value={one.id}>
                {optionText(one)}
              </option>
            ))}
          </select>
        )}
      </Field>
      <label class="button">
        {upload.busy ? t("scan.recordings.sending") : t("scan.recordings.add")}
        <input
          type="file"
          class="unseen"
          accept=".mcap"
          disabled={upload.busy}
          onChange={(event) => {
            const [file] = event.currentTarget.files ?? [];
            event.currentTarget.value = "";
            if (file) void upload.run(() => send(file));
          }}
        />
      </label>
      <Failed failure={upload.failure ?? failure} />
    </div>
  );
}

function optionText({ name, created_at, views, size_bytes }: Recording): string {
  const option = t("scan.recordings.option", {
    when: when(created_at, "medium"),
    views: t("units.views", { count: views }),
    size: t("units.megabytes", { value: decimal(size_bytes / 1e6, 1) }),
  });
  return name === null ? option : t("scan.recordings.named_option", { name, option });
}
